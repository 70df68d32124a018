"""Plan: the ordered effects that a scene calls for, each with its reason, and why the others are left out."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from moireaug.effects import exposure
from moireaug.effects.panel import as_layout, coefficient
from moireaug.effects.view import homography, image_to_photo, jacobian
from moireaug.fields import Range, bounds, ranged_fields
from moireaug.scene import Panel, Scene

HIGHEST = 32  # harmonics per panel pixel beyond which none is ever summed
MOST = 64  # with more harmonics than this, the box is cheaper
MAGNIFIED = "box"
MOST_LEVELS = 10  # halvings of a picture that is seen from afar or at a grazing angle
SIGMAS = 6  # how far noise reaches, in standard deviations


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
        exposure: the method, never "auto": "spectral", "box", "mean", "point" or "supersample:n".
        harmonics: the (k, l) pairs that the spectral method sums.
        levels: halvings of the picture that the prefilter needs.
        steepness: how much a reading can change within one panel pixel; it decides in which precision coordinates are.
        affine: no ray of the view converges; the homography's last row is (0, 0, 1).
        upright: affine, and rows stay rows.
    """

    steps: tuple[Step, ...]
    exposure: str
    harmonics: tuple[tuple[int, int], ...]
    levels: int
    steepness: float
    affine: bool
    upright: bool

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


def _views(scene: Scene, zoom: float) -> tuple[Tensor, float]:
    """Image pixels per photo pixel, d(x, y) / d(u, v), at the corners and the centre of the picture for the turns and
    the lenses that a scene allows: (N, 2, 2) float64."""
    v, lens = scene.view, scene.lens
    turns = [_inside(a, 0.0) for a in (v.yaw, v.pitch)]
    rolls = _inside(v.roll, 0.0, 90.0, -90.0, points=5)
    grid = itertools.product(*turns, rolls, _inside(lens.k1), _inside(lens.k2))
    yaw, pitch, roll, k1, k2 = torch.tensor(list(grid), dtype=torch.float64).T
    fields = {k: torch.zeros_like(yaw) for k in ranged_fields(v)}
    fields |= {"yaw": yaw, "pitch": pitch, "roll": roll}
    fields |= {"fov": torch.full_like(yaw, bounds(v.fov)[1]), "zoom": torch.full_like(yaw, zoom)}
    found = []
    for size in ((256, 256), (192, 256), (256, 192)):
        h, w = size
        m = homography(fields, k1, k2, size, scene.sensor.scale, pose=v.pose, fit=v.fit)
        picture = torch.tensor([[0, 0], [w, 0], [0, h], [w, h], [w / 2, h / 2]], dtype=torch.float64)
        points = image_to_photo(picture.expand(len(m), -1, -1), m, size, (k1, k2))
        found.append(jacobian(torch.linalg.inv(m), points, size, lens=(k1, k2)).flatten(0, 1))
    return torch.cat(found).unique(dim=0)


def _harmonics(scene: Scene, near: Tensor) -> list[tuple[tuple[int, int], float]]:
    """The harmonics whose contrast in the raw reading can exceed the tolerance, strongest first.

    The sinc of the aperture is bounded by its envelope, because its zeros move with the view; so is the cosine of a
    low-pass filter.
    """
    layout, lit = as_layout(scene.panel.layout), scene.panel.lit
    px, py = layout.period
    fill, blur, gain = bounds(scene.sensor.fill)[0], bounds(scene.lens.blur)[0], bounds(scene.sensor.gain)[1]
    subpixels = [s for channel in range(3) for s in layout.of(channel)]
    columns = any(s.width[0] < px for s in subpixels) or bounds(lit)[0] < 1
    rows = any(s.width[1] < py for s in subpixels) or bounds(lit)[0] < 1
    ks, ls = (
        range(HIGHEST * px + 1 if columns else 1),
        range(-HIGHEST * py if rows else 0, HIGHEST * py + 1 if rows else 1),
    )
    lits, j, out = _inside(lit, points=3), near * (bounds(scene.panel.scale)[0] / scene.sensor.scale), []
    for k, l in itertools.product(ks, ls):
        if (k, l) <= (0, 0):
            continue
        per_channel = [0.0, 0.0, 0.0]
        for s in subpixels:
            per_channel[s.channel] += max(abs(coefficient(s, layout.period, k, l, share)) for share in lits)
        top = 2 * gain * max(per_channel)
        if top <= scene.tolerance:
            continue
        f = k / px * j[:, 0] + l / py * j[:, 1]  # (N, 2) cycles per sensor pixel
        envelope = (1 / (math.pi * fill * f.abs()).clamp(min=1.0)).prod(-1)
        passed = envelope * torch.exp(-2 * math.pi**2 * blur**2 * f.square().sum(-1))
        if (contrast := top * float(passed.max())) > scene.tolerance:
            out.append(((k, l), contrast))
    return sorted(out, key=lambda item: -item[1])


def _variance(scene: Scene, far: Tensor, sampled: bool) -> float:
    """The most by which the panel and the aperture blur the picture beyond its own interpolation, in squared image
    pixels."""
    layout, sensor, lens = as_layout(scene.panel.layout), scene.sensor, scene.lens
    optics = exposure.Optics(*(torch.tensor([bounds(r)[1]]).double() for r in (sensor.fill, lens.blur, lens.olpf)))
    most = 0.0
    for alpha in _inside(scene.panel.scale, points=3):
        coarse = max(0.0, 1 / alpha**2 - 1) / 6
        a = far.new_tensor([alpha])
        wide = exposure.footprint(far[None], a / sensor.scale, optics)
        unheld = [
            float(exposure.unheld(wide[..., i], far.new_tensor(s.width[i]), layout.period[i], a).max())
            for channel in range(3) for s in layout.of(channel) for i in (0, 1)
        ]  # fmt: skip
        most = max(most, coarse + (0.0 if sampled else max(unheld)))
    return most


def _finest(scene: Scene, near: Tensor) -> tuple[float, float]:
    """The least width of the box that aperture and spread are, in panel pixels, and the least share of the way between
    two subpixels over which both can be in it."""
    layout, sensor, lens = as_layout(scene.panel.layout), scene.sensor, scene.lens
    optics = exposure.Optics(*(torch.tensor([bounds(r)[0]]).double() for r in (sensor.fill, lens.blur, lens.olpf)))
    pitch = near.new_tensor([bounds(scene.panel.scale)[0] / sensor.scale])
    wide = exposure.footprint(near[None], pitch, optics).amin((0, 1)).tolist()
    side = bounds(scene.panel.lit)[0] ** 0.5
    shares = [
        (wide[i] + s.width[i] * side) / layout.period[i] - 1
        for channel in range(3) for s in layout.of(channel) for i in (0, 1)
    ]  # fmt: skip
    return min(wide), min(shares)


def _flickers(panel: Panel, shutter: Range) -> float:
    """The most by which a row's light can leave its mean, as a share of it."""
    (slow, fast), duty, (short, long) = bounds(panel.pwm), bounds(panel.duty)[0], bounds(shutter)
    if not fast or not long or duty == 1:
        return 0.0
    return (1 - duty) / max(duty, slow * short)


def _off(value: Range, identity: float) -> float:
    return max(abs(v - identity) for v in bounds(value))


def make_plan(scene: Scene) -> Plan:
    """Decide from the scene's ranges alone which effects it calls for; see `Scene.plan`.

    What moves light is absent at its identity; what changes light is absent where it changes no value by more than the
    scene's tolerance.
    """
    panel, v, lens, sensor, dev, t = scene.panel, scene.view, scene.lens, scene.sensor, scene.develop, scene.tolerance
    layout, alpha, gain = as_layout(panel.layout), bounds(panel.scale), bounds(sensor.gain)[1]
    tilted = v.pose == "released" or any(bounds(a) != (0.0, 0.0) for a in (v.yaw, v.pitch))
    rolled = bounds(v.roll) != (0.0, 0.0)
    placed = any(bounds(a) != (0.0, 0.0) for a in (v.shift_x, v.shift_y)) or bounds(v.zoom) != (1.0, 1.0)
    posed, bends = tilted or rolled or placed, any(bounds(k) != (0.0, 0.0) for k in (lens.k1, lens.k2))
    near, far = (_views(scene, zoom) for zoom in reversed(bounds(v.zoom)))

    method = sensor.exposure
    harmonics = _harmonics(scene, near) if method in ("auto", "spectral") else []
    if method == "auto":
        # every third order of a stripe is empty, so the series goes on if one of the last three counts
        cut = any(max(abs(k) / layout.period[0], abs(l) / layout.period[1]) > HIGHEST - 3 for (k, l), _ in harmonics)
        method = MAGNIFIED if cut or len(harmonics) > MOST else "spectral"
    harmonics = harmonics if method == "spectral" else []
    sampled = method == "point" or method.startswith("supersample")

    variance, (finest, share) = _variance(scene, far, sampled), _finest(scene, near)
    held = sampled or (method != "mean" and gain * (1 - share) / (2 * alpha[0]) > t and share < 1 - 1e-9)
    far_off, soft = variance > 1, 2 * gain * variance > t
    solid = all([(s.x0, s.y0, s.x1, s.y1) for s in layout.of(c)] == [(0, 0, *layout.period)] for c in range(3))
    solid = solid and layout.period == (1, 1) and bounds(panel.lit)[0] == 1
    same = solid and sensor.cfa == "none" and sensor.scale == 1 and alpha == (1.0, 1.0)
    exposed = posed or bends or soft or not same
    bayer, bits = sensor.cfa != "none", sensor.bits or 99
    flicker, noisy = _flickers(panel, sensor.shutter), SIGMAS * bounds(sensor.read_noise)[1]

    slopes = [c * 2 * math.pi * (abs(k) / layout.period[0] + abs(l) / layout.period[1]) for (k, l), c in harmonics]
    steepness = {"box": gain / finest, "point": gain * layout.raster}.get(method, gain + sum(slopes))

    angles = [f"{a} {_show(getattr(v, a))}" for a in ("yaw", "pitch", "roll") if bounds(getattr(v, a)) != (0.0, 0.0)]
    pose = ", ".join(angles) + " degrees" if angles else "zoom or shift"
    pose = f"the released code's homography, {pose}" if v.pose == "released" else pose
    resize = ("resize", sensor.scale != 1, f"{dev.resize}, {sensor.scale:g} sensor pixels a photo pixel",
              "one sensor pixel a photo pixel")  # fmt: skip
    under = f"changes nothing by more than {t:.2g}"
    table = (  # effect, whether it is called for, why it is, why it is not
        ("decode", dev.linear_light, "sRGB codes to light", "linear_light is off"),
        ("soften", exposed and soft and not far_off, f"the picture as {'the panel' if sampled else 'an aperture'} sees "
         f"it, blurred by up to {variance**0.5:.2g} image pixels", "the picture is sampled as finely as it is drawn"
         if not far_off else "the prefilter does it"),
        ("prefilter", far_off, f"one reading spans up to {(12 * variance) ** 0.5:.3g} image pixels: the picture is "
         "low-passed by as much", "no reading spans more than a few image pixels"),
        ("panel", exposed and held, f"{_show(panel.scale)} panel pixels an image pixel, the picture held over each",
         "the picture is smooth over a panel pixel to this method"),
        ("layout", bool(sampled or harmonics or method == "box"), *[_layout_reason(scene, method, harmonics)] * 2),
        ("pose", posed, pose, "frontal and edge to edge"),
        ("lens", bends, f"k1 {_show(lens.k1)}, k2 {_show(lens.k2)}", "no distortion, k1 = k2 = 0"),
        ("exposure", exposed, f"{method}: {EXPOSED[method.partition(':')[0]]}{_optics(scene, method)}",
         "each sensor pixel reads its own image pixel"),
        ("vignetting", gain * bounds(lens.vignetting)[1] > t, f"{_show(lens.vignetting)} of the light lost in the corners",
         "no light lost in the corners"),
        ("flicker", gain * flicker > t, f"pulses of {_show(panel.pwm)} Hz, {_show(panel.duty)} on, through a shutter of "
         f"{_show(sensor.shutter)} s, rows read in {_show(sensor.readout)} s",
         under if flicker else "no pulses, or no shutter given"),
        ("gain", _off(sensor.gain, 1) > t, f"raw times {_show(sensor.gain)}", "gain is 1"),
        ("read_noise", noisy > t, f"standard deviation {_show(sensor.read_noise)}", under if noisy else "read_noise is 0"),
        ("shot_noise", SIGMAS * bounds(sensor.shot_noise)[1] > t,
         f"standard deviation {_show(sensor.shot_noise)} times the root of the reading", "shot_noise is 0"),
        ("saturate", gain > 1 or gain * flicker > t, "the reading can exceed a full well", "no reading exceeds a full well"),
        ("bits", 0.5 / (2**bits - 1) > t, f"{bits} bits", under if sensor.bits else "the reading is not rounded"),
        ("demosaic", bayer, f"{dev.demosaic}, RGGB", "every pixel reads all colours"),
        *([] if dev.denoise else [resize]),
        ("balance", max(_off(dev.red, 1), _off(dev.blue, 1)) > t, f"red times {_show(dev.red)}, blue {_show(dev.blue)}",
         "red and blue as they are read"),
        ("encode", dev.linear_light, "light to sRGB codes", "linear_light is off"),
        ("brighten", _off(dev.brighten, 0) > t, f"{_show(dev.brighten)} added", "nothing to add"),
        ("denoise", dev.denoise is not None, f"{dev.denoise}, on every sensor pixel", "not asked for"),
        *([resize] if dev.denoise else []),
        ("register", dev.registered and (posed or bends), "back to the image's frame",
         "the photo is in the image's frame already" if dev.registered else "the photo stays in the camera's frame"),
        ("jpeg", bounds(dev.jpeg)[1] > 0, f"quality {_show(dev.jpeg)}", "no quality given"),
    )  # fmt: skip
    steps = tuple(Step(effect, bool(called), why if called else why_not) for effect, called, why, why_not in table)
    levels = 0
    while far_off and levels < MOST_LEVELS and (3 * 4**levels - 1) / 12 < variance:
        levels += 1
    return Plan(
        steps, method, tuple(h for h, _ in harmonics), levels, steepness,
        affine=not tilted, upright=not tilted and not rolled,
    )  # fmt: skip


EXPOSED = {
    "spectral": "harmonics by their modulation transfer",
    "box": "the overlap of subpixel and aperture",
    "mean": "the panel's mean light alone, so no moiré",
    "point": "the panel read at each sensor pixel's centre",
    "supersample": "the mean over points of the aperture and the lens spread",
}


def _optics(scene: Scene, method: str) -> str:
    lens = scene.lens
    olpf = f", low-pass {_show(lens.olpf)}" if bounds(lens.olpf)[1] else ""
    optics = f"; aperture {_show(scene.sensor.fill)}, spread {_show(lens.blur)}{olpf} sensor pixels"
    return "" if method == "point" else optics


def _layout_reason(scene: Scene, method: str, harmonics: list[tuple[tuple[int, int], float]]) -> str:
    panel, sensor, t = scene.panel, scene.sensor, f"{scene.tolerance:.2g}"
    name = panel.layout if isinstance(panel.layout, str) else f"a cell of {len(panel.layout.subpixels)} subpixels"
    alpha = bounds(panel.scale)
    pitch = _show((sensor.scale / alpha[1], sensor.scale / alpha[0]))
    if method not in ("spectral", "mean"):
        return f"{name}, {pitch} sensor pixels a panel pixel when frontal"
    if not harmonics:
        why = "nothing else is asked for" if method == "mean" else f"no contrast above {t} is left at the sensor"
        return f"{name} gives its mean light alone: {why}"
    (pair, top), n = harmonics[0], len(harmonics)
    return f"{name}: {n} harmonic{'s' * (n > 1)} above {t}, the strongest {pair} up to {top:.2g}"
