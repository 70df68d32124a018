"""The five parts of a scene: panel, view, lens, sensor, develop. Plain numbers and ranges, checked;
no tensors."""

from __future__ import annotations

from moireaug.scene.develop import Develop
from moireaug.scene.fields import Part
from moireaug.scene.lens import Lens
from moireaug.scene.panel import Panel
from moireaug.scene.sensor import Sensor
from moireaug.scene.view import View

PARTS: dict[str, type[Part]] = {
    "panel": Panel,
    "view": View,
    "lens": Lens,
    "sensor": Sensor,
    "develop": Develop,
}
