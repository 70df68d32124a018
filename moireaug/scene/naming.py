"""Describe a scene in a few words: the preset that it is, or the fields that it changes."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from moireaug.scene.parts import PARTS
from moireaug.scene.presets import PRESETS
from moireaug.scene.record import SceneRecord


def preset_name(scene: SceneRecord) -> str:
    """Return the name of the preset that equals a scene, or an empty string."""
    for name, preset in PRESETS.items():
        if preset.to_dict() == scene.to_dict():
            return name
    return ""


def changed_fields(scene: SceneRecord) -> dict[str, dict[str, Any]]:
    """Return the fields in which a scene's parts differ from those of `Scene()`, by part."""
    changed: dict[str, dict[str, Any]] = {}
    for name in PARTS:
        given, default = getattr(scene, name), getattr(SceneRecord(), name)
        changed[name] = {}
        for field in fields(given):
            value = getattr(given, field.name)
            if value != getattr(default, field.name):
                changed[name][field.name] = value
    return changed
