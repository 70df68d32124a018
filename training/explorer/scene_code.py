"""A scene as Python code and as YAML, written as changes to the chosen preset."""

import pprint
import textwrap
from typing import Any

import yaml

from moireaug.scene.parts import PARTS
from moireaug.scenes import Scene, as_scene


def differences(scene: Scene, preset: str) -> dict[str, Any]:
    """Return the argument of `Scene.from_dict` for a scene: a preset's name, and the fields that
    differ from it."""
    ours, theirs = scene.to_dict(), as_scene(preset).to_dict()
    settings: dict[str, Any] = {"preset": preset}
    for part in PARTS:
        changed = {}
        for field, value in ours[part].items():
            if value != theirs[part][field]:
                changed[field] = value
        if changed:
            settings[part] = changed
    return settings


def as_yaml(scene: Scene, preset: str) -> str:
    """Return a scene as YAML, which every command reads from a file with `scene=FILE.yaml`."""
    lines = []
    for key, value in differences(scene, preset).items():
        flow = None if isinstance(value, dict) else False
        lines.append(yaml.safe_dump({key: value}, sort_keys=False, default_flow_style=flow))
    return "".join(lines)


def as_python(scene: Scene, preset: str) -> str:
    """Return Python code that builds a scene and a transform with it."""
    settings = differences(scene, preset)
    code = f'Scene.preset("{preset}")'
    if len(settings) > 1:
        values = pprint.pformat(settings, sort_dicts=False, width=80)
        code = f"Scene.from_dict(\n{textwrap.indent(values, '    ')}\n)"
    lines = [
        "from moireaug import Scene, transforms",
        "",
        f"scene = {code}",
        "transform = transforms.RandomMoire(scene=scene, p=0.5)",
    ]
    return "\n".join(lines) + "\n"
