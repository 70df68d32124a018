"""Plan: the ordered effects that a scene calls for, each with its reason, and why the others are left out."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from moireaug import extremes
from moireaug.effects.panel import as_layout
from moireaug.fields import Range, bounds
from moireaug.scene import Scene

MOST = 64  # harmonics that are summed: with more, a magnified screen is integrated otherwise
MAGNIFIED, BLURRED = "box", "supersample:8"
SOFT = 0.2  # of a subpixel: where light spreads farther, the box's three points cannot stand for a Gaussian
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
        lines = [f"{len(called)} effects are computed, in this order" if called else "The photo is the image"]
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


def _solid(scene: Scene) -> bool:
    """Whether panel pixels emit all colours over all their area."""
    layout = as_layout(scene.panel.layout)
    whole = [[(s.x0, s.y0, s.x1, s.y1) for s in layout.of(c)] == [(0, 0, 1, 1)] for c in range(3)]
    return layout.period == (1, 1) and all(whole) and bounds(scene.panel.lit)[0] == 1


def _off(value: Range, identity: float) -> float:
    return max(abs(v - identity) for v in bounds(value))


@functools.lru_cache(maxsize=256)
def plan_of(scene: Scene) -> Plan:
    """`make_plan`, once per scene."""
    return make_plan(scene)


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
    # a harmonic must not be missed in any image; a blur may be a little short at the far end of a strip
    near = extremes.views(scene, bounds(v.zoom)[1], usual=False)
    far = extremes.views(scene, bounds(v.zoom)[0], usual=True)

    method = sensor.exposure
    harmonics = extremes.harmonics(scene, near) if method in ("auto", "spectral") else []
    if method == "auto":
        # every third order of a stripe is empty, so the series goes on if one of the last three counts
        cut = any(
            max(abs(k) / layout.period[0], abs(l) / layout.period[1]) > extremes.HIGHEST - 3 for (k, l), _ in harmonics
        )
        sharp = extremes.softest(scene, far) < SOFT
        method = "spectral" if not cut and len(harmonics) <= MOST else MAGNIFIED if sharp else BLURRED
    harmonics = harmonics if method == "spectral" else []
    sampled = method == "point" or method.startswith("supersample")

    variance, (finest, share) = extremes.variance(scene, far, sampled), extremes.finest(scene, near)
    held = sampled or (method != "mean" and gain * (1 - share) / (2 * alpha[0]) > t and share < 1 - 1e-9)
    far_off, soft = variance > 1, 2 * gain * variance > t
    same = _solid(scene) and sensor.cfa == "none" and sensor.scale == 1 and alpha == (1.0, 1.0)
    exposed = posed or bends or soft or not same
    bayer, bits = sensor.cfa != "none", sensor.bits or 99
    flicker, noisy = extremes.flickers(panel, sensor.shutter), SIGMAS * bounds(sensor.read_noise)[1]

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
        ("soften", exposed and soft and not far_off,
         f"the picture as {'the panel' if sampled else 'an aperture'} sees "
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
        ("vignetting", gain * bounds(lens.vignetting)[1] > t,
         f"{_show(lens.vignetting)} of the light lost in the corners",
         under if bounds(lens.vignetting)[1] else "no light lost in the corners"),
        ("flicker", gain * flicker > t, f"pulses of {_show(panel.pwm)} Hz, {_show(panel.duty)} on, through a shutter "
         f"of {_show(sensor.shutter)} s, rows read in {_show(sensor.readout)} s",
         under if flicker else "no pulses, or no shutter given"),
        ("gain", _off(sensor.gain, 1) > t, f"raw times {_show(sensor.gain)}",
         under if _off(sensor.gain, 1) else "gain is 1"),
        ("read_noise", noisy > t, f"standard deviation {_show(sensor.read_noise)}",
         under if noisy else "read_noise is 0"),
        ("shot_noise", SIGMAS * bounds(sensor.shot_noise)[1] > t,
         f"standard deviation {_show(sensor.shot_noise)} times the root of the reading",
         under if bounds(sensor.shot_noise)[1] else "shot_noise is 0"),
        ("saturate", gain > 1 or gain * flicker > t, "the reading can exceed a full well",
         "no reading exceeds a full well"),
        ("bits", sensor.bits is not None and 0.5 / (2**bits - 1) > t, f"{bits} bits",
         under if sensor.bits else "the reading is not rounded"),
        ("demosaic", bayer, f"{dev.demosaic}, RGGB", "every pixel reads all colours"),
        *([] if dev.denoise else [resize]),
        ("balance", max(_off(dev.red, 1), _off(dev.blue, 1)) > t,
         f"red times {_show(dev.red)}, blue {_show(dev.blue)}",
         under if _off(dev.red, 1) or _off(dev.blue, 1) else "red and blue as they are read"),
        ("encode", dev.linear_light, "light to sRGB codes", "linear_light is off"),
        ("brighten", _off(dev.brighten, 0) > t, f"{_show(dev.brighten)} added",
         under if _off(dev.brighten, 0) else "nothing to add"),
        ("denoise", dev.denoise is not None, f"{dev.denoise}, on every sensor pixel", "not asked for"),
        *([resize] if dev.denoise else []),
        ("register", dev.registered and (posed or bends), "back to the image's frame",
         "the photo is in the image's frame already" if dev.registered else "the photo stays in the camera's frame"),
        ("jpeg", bounds(dev.jpeg)[1] > 0, f"quality {_show(dev.jpeg)}", "no quality given"),
    )  # fmt: skip
    steps = tuple(Step(effect, bool(called), why if called else why_not) for effect, called, why, why_not in table)
    levels = 0
    while far_off and levels < MOST_LEVELS and 4**levels / 4 < variance:
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
    if _solid(scene):
        return f"{name}: every panel pixel emits all over"
    pitch = _show((sensor.scale / alpha[1], sensor.scale / alpha[0]))
    if method not in ("spectral", "mean"):
        return f"{name}, {pitch} sensor pixels a panel pixel when frontal"
    if not harmonics:
        why = "nothing else is asked for" if method == "mean" else f"no contrast above {t} is left at the sensor"
        return f"{name} gives its mean light alone: {why}"
    (pair, top), n = harmonics[0], len(harmonics)
    return f"{name}: {n} harmonic{'s' * (n > 1)} above {t}, the strongest {pair} up to {top:.2g}"
