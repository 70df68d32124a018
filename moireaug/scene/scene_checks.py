"""Checks of a scene's parts against one another."""

from __future__ import annotations

from moireaug.scene.fields import bounds
from moireaug.scene.parts import Develop, Panel, Sensor, View

_PANEL_SCALE = Panel.__dataclass_fields__["scale"].metadata
MIN_PANEL_SCALE, MAX_PANEL_SCALE = _PANEL_SCALE["low"], _PANEL_SCALE["high"]


def check_scales(panel: Panel, view: View, sensor: Sensor) -> None:
    """Refuse crops that state one or three of what determines one another: ValueError."""
    if not sensor.shrink:
        return
    if bool(panel.width) == bool(sensor.pitch):
        raise ValueError(
            "a crop states Sensor.shrink and one of Panel.width and Sensor.pitch, from which the "
            f"other follows; got Panel.width = {panel.width!r}, Sensor.pitch = {sensor.pitch!r}. "
            "Leave Panel.width at 0 for a part of a screen, or Sensor.pitch for something of so "
            "many panel pixels."
        )
    if not sensor.pitch:
        return
    least, most = panel_scales_of_crop(view, sensor)
    if least < MIN_PANEL_SCALE or most > MAX_PANEL_SCALE:
        raise ValueError(
            "Sensor.shrink * View.zoom / Sensor.pitch, panel pixels per pixel of a crop, must lie "
            f"in [{MIN_PANEL_SCALE:g}, {MAX_PANEL_SCALE:g}]; got {least:g} to {most:g}."
        )


def shrink_of_image(view: View, sensor: Sensor) -> tuple[float, float]:
    """Return the least and the greatest sensor pixels per image pixel of a crop."""
    shrink, zoom = bounds(sensor.shrink), bounds(view.zoom)
    return shrink[0] * zoom[0], shrink[1] * zoom[1]


def panel_scales_of_crop(view: View, sensor: Sensor) -> tuple[float, float]:
    """Return the least and the greatest panel pixels per image pixel of a crop of a screen."""
    shrink, pitch = shrink_of_image(view, sensor), bounds(sensor.pitch)
    return shrink[0] / pitch[1], shrink[1] / pitch[0]


def check_reading(
    panel: Panel, view: View, sensor: Sensor, develop: Develop, *, is_binned: bool
) -> None:
    """Refuse a full reading of scenes that have no one number of sensor pixels, and fields for
    which a binned reading has no closed form: ValueError."""
    if is_binned:
        _check_binned(view, sensor, develop)
        return
    unfixed = f"Sensor.pitch = {sensor.pitch!r}" if sensor.pitch else ""
    if sensor.shrink:
        unfixed = f"Sensor.shrink = {sensor.shrink!r}"
    if isinstance(panel.width, tuple):
        unfixed = f"Panel.width = {panel.width!r}"
    if unfixed:
        raise ValueError(
            "a full reading has one number of sensor pixels for a whole batch, which "
            f"{unfixed} does not fix. Use Sensor(reading='binned'), or Panel.scale and "
            "Sensor.scale."
        )


def _check_binned(view: View, sensor: Sensor, develop: Develop) -> None:
    only: tuple[tuple[str, object, tuple], ...] = (
        ("Sensor.exposure", sensor.exposure, ("auto", "spectral", "mean")),
        ("Develop.demosaic", develop.demosaic, ("bilinear",)),
        ("Develop.denoise", develop.denoise, (None,)),
        ("View.pose", view.pose, ("camera",)),
    )
    for name, got, allowed in only:
        if got not in allowed:
            raise ValueError(
                f"a binned reading has no single sensor pixels: {name} must be "
                f"{' or '.join(map(repr, allowed))}; got {got!r}. Change it, or use "
                "Sensor(reading='full') with Panel.scale and Sensor.scale."
            )
