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
from moireaug.fields import Range, bounds, ranged_fields
from moireaug.scene import Lens, Scene

HIGHEST = 32  # no harmonic beyond this order is ever summed: a screen magnified so far is sampled instead
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
    turns = [_inside(a, 0.0) for a in (v.yaw, v.pitch)]
    rolls = _inside(v.roll, 0.0, 90.0, -90.0, points=5)
    grid = itertools.product(*turns, rolls, _inside(lens.k1), _inside(lens.k2))
    yaw, pitch, roll, k1, k2 = torch.tensor(list(grid), dtype=torch.float64).T
    fields = {k: torch.zeros_like(yaw) for k in ranged_fields(v)}
    fields |= {"yaw": yaw, "pitch": pitch, "roll": roll}
    fields |= {"fov": torch.full_like(yaw, bounds(v.fov)[1]), "zoom": torch.full_like(yaw, bounds(v.zoom)[1])}
    found = []
    for size in ((256, 256), (192, 256), (256, 192)):
        m = homography(fields, k1, k2, size, scene.sensor.scale, pose=v.pose, fit=v.fit)
        ends = [torch.linspace(0, n, 3, dtype=torch.float64) for n in size]
        j = jacobian(torch.linalg.inv(m), *ends, size, lens=(k1, k2)).flatten(1, 2)
        found.append(j[:, [0, 2, 4, 6, 8]].flatten(0, 1))
    return torch.cat(found).unique(dim=0) * (bounds(scene.panel.scale)[0] / scene.sensor.scale)


def _modulus(layout: Layout, lit: Range, k: int, l: int) -> float:
    return max(
        abs(m * phasor)
        for channel in range(3)
        for share in _inside(lit, points=3)
        for m, phasor in [harmonic(layout, channel, k, l, share)]
    )


def _harmonics(scene: Scene) -> list[tuple[tuple[int, int], float]]:
    """The harmonics whose contrast in the raw reading can exceed the tolerance, strongest first.

    The sinc of the aperture is bounded by its envelope, because its zeros move with the view.
    """
    layout, lit = LAYOUTS[scene.panel.layout], scene.panel.lit
    fill, blur, gain = bounds(scene.sensor.fill)[0], bounds(scene.lens.blur)[0], bounds(scene.sensor.gain)[1]
    columns = any(s[3] - s[1] < layout.period[0] for s in layout.subpixels) or bounds(lit)[0] < 1
    rows = any(s[4] - s[2] < layout.period[1] for s in layout.subpixels) or bounds(lit)[0] < 1
    ks, ls = range(HIGHEST + 1 if columns else 1), range(-HIGHEST if rows else 0, HIGHEST + 1 if rows else 1)
    pairs = {(k, l): 2 * gain * _modulus(layout, lit, k, l) for k in ks for l in ls if (k, l) > (0, 0)}
    pairs = {pair: top for pair, top in pairs.items() if top > scene.tolerance}
    j, out = _frequencies(scene), []
    for (k, l), top in pairs.items():
        f = k / layout.period[0] * j[:, 0] + l / layout.period[1] * j[:, 1]  # (N, 2) cycles per sensor pixel
        envelope = (1 / (math.pi * fill * f.abs()).clamp(min=1.0)).prod(-1)
        passed = envelope * torch.exp(-2 * math.pi**2 * blur**2 * f.square().sum(-1))
        if (contrast := top * float(passed.max())) > scene.tolerance:
            out.append(((k, l), contrast))
    return sorted(out, key=lambda item: -item[1])


def _bends(lens: Lens) -> bool:
    return any(bounds(k) != (0.0, 0.0) for k in (lens.k1, lens.k2))


def make_plan(scene: Scene) -> Plan:
    """Decide from the scene's ranges alone which effects it calls for; see `Scene.plan`."""
    panel, v, lens, sensor, dev = scene.panel, scene.view, scene.lens, scene.sensor, scene.develop
    tilted = v.pose == "released" or any(bounds(a) != (0.0, 0.0) for a in (v.yaw, v.pitch))
    turned = any(bounds(a) != (0.0, 0.0) for a in (v.roll, v.shift_x, v.shift_y)) or bounds(v.zoom) != (1.0, 1.0)
    posed, bends = tilted or turned, _bends(lens)
    harmonics = _harmonics(scene) if sensor.exposure in ("auto", "spectral") else []
    method = sensor.exposure
    if method == "auto":
        # every third order of a stripe is empty, so the series goes on if one of the last three counts
        cut = any(max(abs(k), abs(l)) > HIGHEST - 3 for (k, l), _ in harmonics)
        method = FALLBACK if cut or len(harmonics) > MOST else "spectral"
    held = method not in ("spectral", "mean")
    angles = [f"{a} {_show(getattr(v, a))}" for a in ("yaw", "pitch", "roll") if bounds(getattr(v, a)) != (0.0, 0.0)]
    pose = ", ".join(angles) + " degrees" if angles else "zoom or shift"
    pose = f"the released code's homography, {pose}" if v.pose == "released" else pose
    frame = "the photo stays in the camera's frame"
    optics = f"; aperture {_show(sensor.fill)}, spread {_show(lens.blur)} sensor pixels"
    table = (  # effect, whether it is called for, why it is, why it is not
        ("decode", dev.linear_light, "sRGB codes to light", "linear_light is off"),
        ("panel", held, f"{_show(panel.scale)} panel pixels an image pixel, each of one colour",
         "the picture is smooth over a panel pixel to this method"),
        ("layout", bool(held or harmonics), *[_layout_reason(scene, method, harmonics)] * 2),
        ("pose", posed, pose, "frontal and edge to edge"),
        ("lens", bends, f"k1 {_show(lens.k1)}, k2 {_show(lens.k2)}", "no distortion, k1 = k2 = 0"),
        ("exposure", True, f"{method}: {EXPOSED[method.partition(':')[0]]}{optics if method != 'point' else ''}", ""),
        ("gain", bounds(sensor.gain) != (1.0, 1.0), f"raw times {_show(sensor.gain)}", "gain is 1"),
        ("read_noise", bounds(sensor.read_noise)[1] > 0, f"standard deviation {_show(sensor.read_noise)}",
         "read_noise is 0"),
        ("saturate", bounds(sensor.gain)[1] > 1, "gain above 1 can overexpose", "no gain above 1"),
        ("demosaic", True, f"{dev.demosaic}, RGGB", ""),
        ("resize", sensor.scale != 1, f"{dev.resize}, {sensor.scale:g} sensor pixels a photo pixel",
         "one sensor pixel a photo pixel"),
        ("encode", dev.linear_light, "light to sRGB codes", "linear_light is off"),
        ("brighten", bounds(dev.brighten) != (0.0, 0.0), f"{_show(dev.brighten)} added", "nothing to add"),
        ("register", dev.registered and (posed or bends), "back to the image's frame",
         "the photo is in the image's frame already" if dev.registered else frame),
    )  # fmt: skip
    steps = tuple(Step(effect, called, why if called else why_not) for effect, called, why, why_not in table)
    return Plan(steps, method, tuple(h for h, _ in harmonics) if method == "spectral" else (), affine=not tilted)


EXPOSED = {
    "spectral": "harmonics by their modulation transfer",
    "mean": "the panel's mean light alone, so no moiré",
    "point": "the panel read at each sensor pixel's centre",
    "supersample": "the mean over points of the aperture and the lens spread",
}


def _layout_reason(scene: Scene, method: str, harmonics: list[tuple[tuple[int, int], float]]) -> str:
    panel, sensor, t = scene.panel, scene.sensor, f"{scene.tolerance:.2g}"
    alpha = bounds(panel.scale)
    pitch = _show((sensor.scale / alpha[1], sensor.scale / alpha[0]))
    if method not in ("spectral", "mean"):
        return f"{panel.layout}, {pitch} sensor pixels a panel pixel when frontal"
    if not harmonics:
        why = "nothing else is asked for" if method == "mean" else f"no contrast above {t} is left at the sensor"
        return f"{panel.layout} gives its mean light alone: {why}"
    (pair, top), n = harmonics[0], len(harmonics)
    return f"{panel.layout}: {n} harmonic{'s' * (n > 1)} above {t}, the strongest {pair} up to {top:.2g}"
