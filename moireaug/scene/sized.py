"""A scene for pictures of one size, as effects judge it: what depends on how many panel and sensor
pixels an image pixel gets."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from moireaug.scene.fields import Range, bounds
from moireaug.scene.parts import Panel, Sensor
from moireaug.scene.record import SceneRecord
from moireaug.scene.scene_checks import MIN_PANEL_SCALE, panel_scales_of_crop, shrink_of_image
from moireaug.scene.sensor import MIN_PITCH, SHORTER_SIDE

NOMINAL_SIZE = (224, 224)  # size of a plan when none is given


def size_octave(scene: SceneRecord, size: tuple[int, int]) -> int:
    """Return the exponent of the greatest power of 2 not above a picture's longer side, by which
    crops and scenes with `Panel.width` are planned; 0 for others, which do not differ by size."""
    octave = 0
    if scene.panel.width or scene.is_crop:
        # compared, so that torch.compile, to which a size may be a symbol, guards the result
        while max(size) >= 2 ** (octave + 1):
            octave += 1
    return octave


def panel_scales(scene: SceneRecord, size: tuple[int, int]) -> tuple[float, float]:
    """Return the least and the greatest panel pixels per image pixel, for pictures of all sizes in
    the octave of `size` (height, width)."""
    if not scene.panel.width:
        if scene.is_crop:
            return panel_scales_of_crop(scene.view, scene.sensor)
        return bounds(scene.panel.scale)
    low, high = bounds(scene.panel.width)
    shortest = 2 ** size_octave(scene, size)
    return low / (2 * shortest), high / shortest


def scene_of_size(scene: SceneRecord, size: tuple[int, int] = NOMINAL_SIZE) -> SceneRecord:
    """Return the scene that effects judge, for pictures of `size` (height, width), and of all sizes
    in the same octave: `Panel.width`, if given, is replaced by a range of `Panel.scale`, and
    `Sensor.reading` by "binned" or "full". Of crops, `Sensor.pitch` is given, too, `Panel.scale`
    follows, and `Sensor.crop_x` and `crop_y` are the part of the photo that they see.

    Raises:
        ValueError: a `Panel.width` of far fewer panel pixels than the picture has.
    """
    if not scene.panel.width and not scene.is_crop:
        return scene
    scales, panel, view, sensor = panel_scales(scene, size), scene.panel, scene.view, scene.sensor
    if scales[0] < MIN_PANEL_SCALE and panel.width:
        least = bounds(panel.width)[0] * MIN_PANEL_SCALE / scales[0]
        raise ValueError(
            f"Panel.width must be at least {least:g} panel pixels for pictures of {size[0]} x "
            f"{size[1]}; got {panel.width!r}. Raise it, or make the pictures smaller."
        )
    reading, pitch = "binned" if scene.is_binned else "full", sensor.pitch
    if scene.is_crop:
        view = replace(view, fit=False)
        pitch = pitch or _pitches_of_thing(scene, scales, size)
        across = _extent_of_crops(scene, sensor.crop_x, size)
        down = _extent_of_crops(scene, sensor.crop_y, size)
        sensor = replace(sensor, crop_x=across, crop_y=down)
    return scene.with_parts(
        panel=replace(panel, width=0.0, scale=scales),
        view=view,
        sensor=replace(sensor, reading=reading, pitch=pitch),
    )


def parts_of_crops(scene: SceneRecord, shrink: Any) -> tuple[Panel, Sensor]:
    """Return the panel and the sensor of a scene for images that are crops, for `with_shrink`."""
    if not scene.is_binned:
        raise ValueError(
            "shrink is for scenes that state Panel.width, Sensor.pitch or Sensor.shrink; got "
            f"{shrink!r} for one that states Panel.scale and Sensor.scale. Leave it out: None, "
            "or null on a command line."
        )
    panel, sensor = scene.panel, replace(scene.sensor, shrink=shrink, scale=1.0)
    if sensor.pitch:
        panel = replace(panel, width=0.0, scale=1.0)
    return panel, sensor


def _extent_of_crops(scene: SceneRecord, place: Range, size: tuple[int, int]) -> Range:
    """Return the part of the photo, from 0 at one edge to 1 at the other, that crops see."""
    longer_side = 2.0 ** (size_octave(scene, size) + 1)  # of a picture, at most
    most = longer_side * bounds(scene.sensor.shrink)[1] / scene.sensor.pixels
    low, high = bounds(place)
    side = min(1.0, most / SHORTER_SIDE)  # of a crop, over that of its photo, at most
    return low * (1 - side), high + (1 - high) * side


def _pitches_of_thing(
    scene: SceneRecord, scales: tuple[float, float], size: tuple[int, int]
) -> tuple[float, float]:
    """Return the least and the greatest sensor pixels per panel pixel of a crop of `scales`."""
    shrink = shrink_of_image(scene.view, scene.sensor)
    low, high = shrink[0] / scales[1], shrink[1] / scales[0]
    most = Sensor.__dataclass_fields__["pitch"].metadata["high"]
    if high > most:
        raise ValueError(
            f"Panel.width = {scene.panel.width!r} and Sensor.shrink = {scene.sensor.shrink!r} "
            f"give pictures of {size[0]} x {size[1]} up to {high:g} sensor pixels per panel "
            f"pixel, where {most:g} are allowed. Raise Panel.width."
        )
    return max(low, MIN_PITCH), max(high, MIN_PITCH)
