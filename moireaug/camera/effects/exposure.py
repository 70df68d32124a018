"""The exposure, and the steps that it integrates: subpixels, pose, lens and crosstalk."""

from __future__ import annotations

import math

from torch import Tensor

from moireaug.camera.effects.base import (
    Effect,
    Verdict,
    WithinExposure,
    called,
    format_range,
    left_out,
)
from moireaug.camera.effects.srgb import in_codes
from moireaug.camera.exposure.choose import method_of
from moireaug.camera.exposure.extreme_readings import harmonics, harmonics_in_bins
from moireaug.camera.exposure.extremes import least_bin_scale
from moireaug.scene.fields import bounds, varies
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord


class PanelLayout(WithinExposure):
    """The panel's unit cell: its contrast at the sensor is the moiré."""

    name = "layout"

    def verdict(self, scene: SceneRecord) -> Verdict:
        panel, method = scene.panel, method_of(scene)
        layout = panel.layout
        name = layout if isinstance(layout, str) else f"a cell of {len(layout.subpixels)} subpixels"
        if scene.is_solid:
            return left_out(f"{name}: every panel pixel emits all over")
        if not scene.shows_pattern:
            return left_out(f"{name} gives its mean light alone: nothing else is asked for")
        if not method.sums_harmonics:
            low, high = bounds(panel.scale)
            pitch = format_range((scene.sensor.scale / high, scene.sensor.scale / low))
            return called(f"{name}, {pitch} sensor pixels a panel pixel when frontal")
        if not method.harmonics:
            where = "in the photo" if scene.is_binned else "at the sensor"
            return left_out(
                f"{name} gives its mean light alone: no contrast above {scene.tolerance:.2g} is "
                f"left {where}"
            )
        possible = harmonics_in_bins(scene) if scene.is_binned else harmonics(scene)
        (pair, top), n = possible[0], len(method.harmonics)
        counted = "1 harmonic" if n == 1 else f"{n} harmonics"
        reason = (
            f"{name}: {counted} above {scene.tolerance:.2g}, the strongest {pair} up to {top:.2g}"
        )
        if len(possible) > n:
            _, strength = possible[n]
            reason += (
                f"; {len(possible) - n} weaker ones, up to {strength:.2g}, are too many to sum"
            )
        return called(reason)


class Pose(WithinExposure):
    """Yaw, pitch, roll, zoom and shift of the screen: a homography."""

    name = "pose"

    def verdict(self, scene: SceneRecord) -> Verdict:
        if not scene.is_posed:
            return left_out("frontal and edge to edge")
        view, angles = scene.view, []
        for angle in ("yaw", "pitch", "roll"):
            if varies(getattr(view, angle)):
                angles.append(f"{angle} {format_range(getattr(view, angle))}")
        reason = ", ".join(angles) + " degrees" if angles else "zoom or shift"
        if view.pose == "released":
            reason = f"the released code's homography, {reason}"
        return called(reason)


class LensDistortion(WithinExposure):
    """The lens bends the photo radially."""

    name = "lens"

    def verdict(self, scene: SceneRecord) -> Verdict:
        lens = scene.lens
        if not scene.is_bent:
            return left_out("no distortion, k1 = k2 = 0")
        return called(f"k1 {format_range(lens.k1)}, k2 {format_range(lens.k2)}")


class Crosstalk(WithinExposure):
    """Overlapping bands of the colour filters."""

    name = "crosstalk"

    def verdict(self, scene: SceneRecord) -> Verdict:
        crosstalk = scene.sensor.crosstalk
        if not varies(crosstalk):
            return left_out("each filter passes its own colour alone")
        return called(f"{format_range(crosstalk)} of a filter's light from its neighbours' colours")


class Exposure(Effect):
    """Panel light integrated over the aperture and the spread of each sensor pixel that the photo
    reads."""

    name = "exposure"

    def verdict(self, scene: SceneRecord) -> Verdict:
        if not _is_exposed(scene):
            return left_out("each sensor pixel reads its own image pixel")
        method, lens = method_of(scene), scene.lens
        reason = f"{method.name}: {method.reason}"
        if not method.has_aperture:
            return called(reason)
        if scene.is_binned:
            least = least_bin_scale(scene, bounds(scene.panel.scale)[0])
            reason += f", in bins of {least:.2g} sensor pixels a side or more"
        reason += f"; aperture {format_range(scene.sensor.fill)}, spread {format_range(lens.blur)}"
        if varies(lens.motion_x) or varies(lens.motion_y):
            reason += f", motion {format_range(lens.motion_x)} and {format_range(lens.motion_y)}"
        if varies(lens.olpf):
            reason += f", low-pass {format_range(lens.olpf)}"
        return called(f"{reason} sensor pixels")

    def __call__(self, light: Tensor, shot: ShotRecord) -> Tensor:
        return shot.plan.method(light, shot)


def _is_exposed(scene: SceneRecord) -> bool:
    """Whether a sensor pixel ever reads anything but its own image pixel."""
    lens, sensor = scene.lens, scene.sensor
    if scene.is_posed or scene.is_bent or not scene.is_solid or scene.is_binned:
        return True
    if varies(lens.motion_x) or varies(lens.motion_y) or varies(sensor.crosstalk):
        return True
    if sensor.cfa != "none" or sensor.scale != 1 or varies(scene.panel.scale, 1.0):
        return True
    sigma = (bounds(lens.blur)[1] ** 2 + bounds(lens.olpf)[1] ** 2 / 4) ** 0.5
    leak = sigma / math.sqrt(2 * math.pi)  # of the light next to each of a pixel's four edges
    return in_codes(4 * leak * bounds(sensor.gain)[1], scene) > scene.tolerance
