"""The five parts of a scene: panel, view, lens, sensor, develop. Plain numbers and ranges, checked;
no tensors."""

from __future__ import annotations

from moireaug.scene.develop import DEMOSAIC_NAMES, DENOISER_NAMES, RESIZES, Develop
from moireaug.scene.fields import Part
from moireaug.scene.lens import Lens
from moireaug.scene.panel import Panel
from moireaug.scene.sensor import CFAS, EXPOSURES, READINGS, Sensor
from moireaug.scene.view import POSES, View

__all__ = [
    "CFAS",
    "DEMOSAIC_NAMES",
    "DENOISER_NAMES",
    "EXPOSURES",
    "PARTS",
    "POSES",
    "READINGS",
    "RESIZES",
    "Develop",
    "Lens",
    "Panel",
    "Sensor",
    "View",
]

PARTS: dict[str, type[Part]] = {
    "panel": Panel,
    "view": View,
    "lens": Lens,
    "sensor": Sensor,
    "develop": Develop,
}
