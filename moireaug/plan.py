"""Plan: the ordered effects that a scene calls for, each with its reason, and why the others are left out."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from moireaug.effects.panel import LAYOUTS, Layout, harmonic
from moireaug.effects.view import homography, jacobian
from moireaug.scene import Lens, Range, Scene, bounds, ranged_fields

HIGHEST = 32  # no harmonic beyond this order is ever summed
MOST = 64  # with more harmonics than this, averaging 8 x 8 points of the aperture is cheaper
FALLBACK = "supersample:8"


@dataclass(frozen=True)
class Step:
    """One effect of a plan: its name, whether the scene calls for it, and why."""

    effect: str
    called: bool
    reason: str


@dataclass(frozen=True)
class Plan:
    """The effects of a scene, in the order in which light meets them. `"pose" in plan` asks whether one is called for.

    Args:
        steps: every effect, called for or not.
        exposure: the method, never "auto": "spectral", "point" or "supersample:n".
        harmonics: the (k, l) pairs that the spectral method sums.
        affine: no ray of the view converges; the homography's last row is (0, 0, 1).
    """

    steps: tuple[Step, ...]
    exposure: str
    harmonics: tuple[tuple[int, int], ...]
    affine: bool

    def __contains__(self, effect: object) -> bool:
        return any(s.called for s in self.steps if s.effect == effect)

    def __iter__(self) -> Iterator[Step]:
        return (s for s in self.steps if s.called)

    def __str__(self) -> str:
        called, absent = list(self), [s for s in self.steps if not s.called]
        width = max(len(s.effect) for s in self.steps) + 2
        lines = [f"{len(called)} effects are computed, in this order"]
        lines += [f"  {i:2d}  {s.effect:{width}}{s.reason}" for i, s in enumerate(called, 1)]
        lines += [f"{len(absent)} effects are left out"] if absent else []
        lines += [f"   -  {s.effect:{width}}{s.reason}" for s in absent]
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Plain values: effects called for, those left out (both effect to reason), exposure and harmonics."""
        return {
            "effects": {s.effect: s.reason for s in self.steps if s.called},
            "left_out": {s.effect: s.reason for s in self.steps if not s.called},
            "exposure": self.exposure,
            "harmonics": [list(h) for h in self.harmonics],
        }


def _show(value: Range, unit: str = "") -> str:
    low, high = bounds(value)
    return f"{low:g}{unit}" if low == high else f"{low:g} to {high:g}{unit}"


def _inside(value: Range, *marks: float, points: int = 2) -> list[float]:
    """A range's ends, evenly spread points between them, and those of `marks` that it holds."""
    low, high = bounds(value)
    spread = [low + (high - low) * i / (points - 1) for i in range(points)]
    return sorted({*spread, *(m for m in marks if low < m < high)})


def _frequencies(scene: Scene) -> Tensor:
    """Panel pixels per sensor pixel, d(X, Y) / d(u, v), at the corners and the centre of the photo for the views that
    magnify most: (N, 2, 2) float64."""
    v, lens = scene.view, scene.lens
    angles = [_inside(a, 0.0, points=4) for a in (v.yaw, v.pitch)]
    rolls = _inside(v.roll, 0.0, 90.0, -90.0, points=7)
    grid = itertools.product(*angles, rolls, _inside(v.fov), _inside(lens.k1), _inside(lens.k2))
    yaw, pitch, roll, fov, k1, k2 = torch.tensor(list(grid), dtype=torch.float64).T
    fields = {k: torch.zeros_like(yaw) for k in ranged_fields(v)}
    fields |= {"yaw": yaw, "pitch": pitch, "roll": roll, "fov": fov, "zoom": torch.full_like(yaw, bounds(v.zoom)[1])}
    found = []
    for size in ((256, 256), (192, 256), (256, 192)):
        m = homography(fields, k1, k2, size, scene.sensor.scale, pose=v.pose, fit=v.fit)
        ends = [torch.linspace(0, n, 3, dtype=torch.float64) for n in size]
        found.append(jacobian(torch.linalg.inv(m), *ends, size, lens=(k1, k2)).flatten(0, 2))
    return torch.cat(found) * (bounds(scene.panel.scale)[0] / scene.sensor.scale)


def _contrast(scene: Scene, layout: Layout, k: int, l: int, j: Tensor) -> float:  # noqa: E741
    """Upper bound of a harmonic's amplitude in the raw reading, over the scene's ranges.

    The sinc of the aperture is bounded by its envelope, because its zeros move with the view.
    """
    (px, py), fill, blur = layout.period, bounds(scene.sensor.fill)[0], bounds(scene.lens.blur)[0]
    modulus = max(
        abs(m * phasor)
        for channel in range(3)
        for lit in _inside(scene.panel.lit, points=3)
        for m, phasor in [harmonic(layout, channel, k, l, lit)]
    )
    f = k / px * j[:, 0] + l / py * j[:, 1]  # (N, 2), cycles per sensor pixel along u and v
    envelope = (1 / (math.pi * fill * f.abs()).clamp(min=1.0)).prod(-1)
    spread = torch.exp(-2 * math.pi**2 * blur**2 * f.square().sum(-1))
    return 2 * modulus * float((envelope * spread).max()) * bounds(scene.sensor.gain)[1]


def _harmonics(scene: Scene) -> list[tuple[tuple[int, int], float]]:
    """The harmonics whose contrast exceeds the tolerance, strongest first."""
    layout, j, out = LAYOUTS[scene.panel.layout], _frequencies(scene), []
    columns = any(s[3] - s[1] < layout.period[0] for s in layout.subpixels)
    rows = any(s[4] - s[2] < layout.period[1] for s in layout.subpixels) or bounds(scene.panel.lit)[0] < 1
    for k in range(HIGHEST + 1 if columns else 1):
        for l in range(-HIGHEST if rows and k else 0, HIGHEST + 1 if rows else 1):  # noqa: E741
            if (k, l) > (0, 0) and (contrast := _contrast(scene, layout, k, l, j)) > scene.tolerance:
                out.append(((k, l), contrast))
    return sorted(out, key=lambda item: -item[1])


def _bends(lens: Lens) -> bool:
    return any(bounds(k) != (0.0, 0.0) for k in (lens.k1, lens.k2))


def make_plan(scene: Scene) -> Plan:
    """Decide from the scene's ranges alone which effects it calls for; see `Scene.plan`."""
    panel, v, lens, sensor, dev = scene.panel, scene.view, scene.lens, scene.sensor, scene.develop
    released = v.pose == "released"
    tilted = released or any(bounds(a) != (0.0, 0.0) for a in (v.yaw, v.pitch))
    places = [bounds(a) for a in (v.roll, v.shift_x, v.shift_y)]
    posed = tilted or any(p != (0.0, 0.0) for p in places) or bounds(v.zoom) != (1.0, 1.0)
    bends = _bends(lens)
    noisy, gain = bounds(sensor.read_noise)[1] > 0, bounds(sensor.gain)
    harmonics = _harmonics(scene) if sensor.exposure in ("auto", "spectral") else []
    method = sensor.exposure
    if method == "auto":
        method = FALLBACK if len(harmonics) > MOST else "spectral"
    held = method != "spectral"
    light, t = math.prod((bounds(panel.lit)[1], 1 / 3)), f"{scene.tolerance:.2g}"
    pitch = sensor.scale / bounds(panel.scale)[1], sensor.scale / bounds(panel.scale)[0]
    if held:
        layout = True, f"{panel.layout}, each subpixel read at {_show(pitch)} sensor pixels a panel pixel"
    elif harmonics:
        (k, l), top = harmonics[0]
        layout = True, f"{panel.layout}: {len(harmonics)} harmonics above {t}, the strongest ({k}, {l}) up to {top:.2g}"
    else:
        layout = False, f"{panel.layout}: no contrast above {t} is left at the sensor, only its mean light {light:.2g}"
    angles = ", ".join(
        f"{a} {_show(getattr(v, a))}" for a in ("yaw", "pitch", "roll") if bounds(getattr(v, a)) != (0, 0)
    )
    why = {
        "spectral": "the harmonics that the optics pass, each by its modulation transfer",
        "point": "the panel read at each sensor pixel's centre",
    }
    steps = (
        Step("decode", dev.linear_light, "sRGB codes to light" if dev.linear_light else "linear_light is off"),
        Step(
            "panel", held, f"{_show(panel.scale)} panel pixels an image pixel, one colour each"
            if held else "the picture is smooth over a panel pixel to this method",
        ),
        Step("layout", *layout),
        Step(
            "pose", posed, ("released code's homography, " if released else "") + (angles + " degrees" if angles else "zoom or shift")
            if posed else "frontal and edge to edge",
        ),
        Step("lens", bends, f"k1 {_show(lens.k1)}, k2 {_show(lens.k2)}" if bends else "k1 = k2 = 0"),
        Step("exposure", True, f"{method}: {why.get(method, 'the mean over points of the aperture and the lens spread')}"),
        Step("gain", gain != (1, 1), f"raw times {_show(gain)}" if gain != (1, 1) else "gain is 1"),
        Step("read_noise", noisy, f"standard deviation {_show(sensor.read_noise)}" if noisy else "read_noise is 0"),
        Step("saturate", gain[1] > 1, "gain above 1 can overexpose" if gain[1] > 1 else "no gain above 1"),
        Step("demosaic", True, f"{dev.demosaic}, RGGB"),
        Step(
            "resize", sensor.scale != 1, f"{dev.resize}, {sensor.scale:g} sensor pixels a photo pixel"
            if sensor.scale != 1 else "one sensor pixel a photo pixel",
        ),
        Step("encode", dev.linear_light, "light to sRGB codes" if dev.linear_light else "linear_light is off"),
        Step(
            "brighten", bounds(dev.brighten) != (0, 0), f"{_show(dev.brighten)} added"
            if bounds(dev.brighten) != (0, 0) else "nothing to add",
        ),
        Step(
            "register", dev.registered and (posed or bends), "back to the image's frame"
            if dev.registered and (posed or bends)
            else ("the photo is in the image's frame already" if dev.registered else "the photo stays in the camera's frame"),
        ),
    )  # fmt: skip
    return Plan(steps, method, tuple(h for h, _ in harmonics) if method == "spectral" else (), affine=not tilted)
