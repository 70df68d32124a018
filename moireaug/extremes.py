"""What a scene's ranges allow at most: the extremes by which a plan is decided."""

from __future__ import annotations

import itertools
import math

import torch
from torch import Tensor

from moireaug.effects import exposure
from moireaug.effects.panel import as_layout, coefficient
from moireaug.effects.view import homography, image_to_photo, jacobian
from moireaug.fields import Range, bounds, ranged_fields
from moireaug.parts import Panel
from moireaug.scene import Scene

SHAPES = ((256, 256), (192, 256), (256, 192))  # height and width: what is decided for these holds for most images
STRIPS = ((16, 256), (256, 16))  # a view of a long strip converges most
HIGHEST = 32  # harmonics per panel pixel beyond which none is ever summed


def _inside(value: Range, *marks: float, points: int = 2) -> list[float]:
    """A range's ends, evenly spread points between them, and those of `marks` that it holds."""
    low, high = bounds(value)
    spread = [low + (high - low) * i / (points - 1) for i in range(points)]
    return sorted({*spread, *(m for m in marks if low < m < high)})


def views(scene: Scene, zoom: float, *, usual: bool) -> tuple[Tensor, float]:
    """Image pixels per photo pixel, d(x, y) / d(u, v), at the corners and the centre of the picture for the turns and
    the lenses that a scene allows: (N, 2, 2) float64."""
    v, lens = scene.view, scene.lens
    turns = [_inside(a, 0.0) for a in (v.yaw, v.pitch)]
    rolls = _inside(v.roll, 0.0, 90.0, -90.0, points=9)
    grid = itertools.product(*turns, rolls, _inside(lens.k1), _inside(lens.k2))
    yaw, pitch, roll, k1, k2 = torch.tensor(list(grid), dtype=torch.float64).T
    fields = {k: torch.zeros_like(yaw) for k in ranged_fields(v)}
    fields |= {"yaw": yaw, "pitch": pitch, "roll": roll}
    fields |= {"fov": torch.full_like(yaw, bounds(v.fov)[1]), "zoom": torch.full_like(yaw, zoom)}
    found = []
    for size in SHAPES if usual else SHAPES + STRIPS:
        h, w = size
        m = homography(fields, k1, k2, size, scene.sensor.scale, pose=v.pose, fit=v.fit)
        picture = torch.tensor([[0, 0], [w, 0], [0, h], [w, h], [w / 2, h / 2]], dtype=torch.float64)
        points = image_to_photo(picture.expand(len(m), -1, -1), m, size, (k1, k2))
        found.append(jacobian(torch.linalg.inv(m), points, size, lens=(k1, k2)).flatten(0, 1))
    return torch.cat(found).unique(dim=0)


def harmonics(scene: Scene, near: Tensor) -> list[tuple[tuple[int, int], float]]:
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
    lits, j, out = _inside(lit, points=9), near * (bounds(scene.panel.scale)[0] / scene.sensor.scale), []
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


def variance(scene: Scene, far: Tensor, sampled: bool) -> float:
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


def finest(scene: Scene, near: Tensor) -> tuple[float, float]:
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


def softest(scene: Scene, far: Tensor) -> float:
    """The most that lens and low-pass filter can spread light, as a share of the narrowest subpixel."""
    layout, sensor, lens = as_layout(scene.panel.layout), scene.sensor, scene.lens
    sigma = (bounds(lens.blur)[1] ** 2 + bounds(lens.olpf)[1] ** 2 / 4) ** 0.5
    most = float(far.norm(dim=-1).max()) * bounds(scene.panel.scale)[1] / sensor.scale * sigma
    narrow = min(w for c in range(3) for s in layout.of(c) for w in s.width) * bounds(scene.panel.lit)[0] ** 0.5
    return most / narrow


def flickers(panel: Panel, shutter: Range) -> float:
    """The most by which a row's light can leave its mean, as a share of it."""
    (slow, fast), duty, (short, long) = bounds(panel.pwm), bounds(panel.duty)[0], bounds(shutter)
    if not fast or not long or duty == 1:
        return 0.0
    cycles = slow * short  # of the shortest exposure, at least
    brighter, darker = (1 - duty) / max(duty, cycles), 1.0 if cycles <= 1 - duty else (1 - duty) / cycles
    return max(brighter, darker)
