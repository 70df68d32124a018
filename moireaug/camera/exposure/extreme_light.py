"""The most light that a scene can show, with its flicker and glare, whatever its ranges draw."""

from __future__ import annotations

from moireaug.scene.fields import bounds, deviation
from moireaug.scene.record import SceneRecord


def modulation_depth(scene: SceneRecord) -> float:
    """Return the most by which a row's light can differ from the mean, as a share of it."""
    panel, (short, long) = scene.panel, bounds(scene.sensor.shutter)
    (slow, fast), duty = bounds(panel.pwm), bounds(panel.duty)[0]
    if not fast or not long or duty == 1:
        return 0.0
    cycles = slow * short  # the fewest in an exposure
    brighter = (1 - duty) / max(duty, cycles)
    darker = 1.0 if cycles <= 1 - duty else (1 - duty) / cycles
    return max(brighter, darker)


def max_glare(scene: SceneRecord) -> float:
    """Return the most light that the glass can reflect, which it does in a corner of the photo."""
    panel = scene.panel
    return bounds(panel.glare)[1] * (1 + deviation(panel.glare_x, 0) + deviation(panel.glare_y, 0))


def can_saturate(scene: SceneRecord) -> bool:
    """Return whether the reading of a white screen can exceed a full well."""
    brightest = 1 + modulation_depth(scene) + max_glare(scene)
    return bounds(scene.sensor.gain)[1] * brightest > 1 + scene.tolerance
