"""Scenes on a command line: a preset's name, or a YAML file of a scene."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from moireaug.scene.scene import Scene, as_scene
from training.files import UniqueKeyLoader

SUFFIXES = (".yaml", ".yml")


def inlined(scene: Any) -> Any:
    """Return a command line's scene with the content of a YAML file in place of its name.

    A run's settings thus hold the scene itself, and no file is read again.

    Args:
        scene: a preset's name, a file's name that ends with .yaml or .yml, or a mapping.

    Raises:
        ValueError: a file that holds no scene.
    """
    if isinstance(scene, str) and scene.endswith(SUFFIXES):
        return read(Path(scene))
    return scene


def load(scene: str) -> Scene:
    """Return the scene of a preset's name or of a YAML file.

    Raises:
        ValueError: an unknown name, or a file that holds no scene.
    """
    return as_scene(inlined(scene))


def read(path: Path) -> dict[str, Any]:
    """Return the content of a YAML file of a scene, checked.

    It is what `Scene.from_dict` takes: the scene's parts with the fields that differ, ranges as
    lists of two, and, with `preset`, the name of the scene to start from:

        preset: phone_at_monitor
        panel: {lit: [0.6, 0.9]}
        lens: {blur: 0.3}

    Raises:
        ValueError: no such file, no YAML mapping, or no scene; with what is wrong.
    """
    try:
        values = yaml.load(path.read_text(encoding="utf-8"), UniqueKeyLoader)
    except OSError as error:
        raise ValueError(f"scene={path} could not be read ({error.strerror}).") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        said = " ".join(str(error).split())
        raise ValueError(f"scene={path} could not be read as YAML: {said}.") from error
    if not isinstance(values, dict):
        raise ValueError(f"scene={path} holds no scene: it must be a YAML mapping of its parts.")
    try:
        Scene.from_dict(values)
    except (ValueError, TypeError) as error:
        raise ValueError(f"scene={path} holds no scene: {error}") from error
    return values
