"""Panel light integrated over every sensor pixel that a photo reads: the exposure of a plan, for a whole batch."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from moireaug.effects import bayer, exposure
from moireaug.effects.bayer import SITES
from moireaug.effects.exposure import Optics
from moireaug.effects.panel import Layout, Subpixel, as_layout, coefficient, prefilter, spread
from moireaug.effects.view import enlarge, image_to_photo, jacobian, lattice, look, nodes
from moireaug.fields import bounds
from moireaug.plan import Plan
from moireaug.shot import Shot

AT_ONCE = 2**18  # sensor pixels of one colour that are worked on together: what a processor's cache holds


def integrate(light: Tensor, shot: Shot, plan: Plan) -> Tensor:
    """Panel light (B, 3, H, W) as each sensor pixel reads it: packed planes (B, 4 or 3, h, w)."""
    if "exposure" not in plan:
        return light
    inverse = torch.linalg.inv(shot.matrix())
    sampled = plan.exposure == "point" or plan.exposure.startswith("supersample")
    light = _picture(light, shot, plan, inverse, sampled)
    return (_sampled if sampled else _smooth)(light, shot, plan, inverse)


def optics_of(shot: Shot) -> Optics:
    """The drawn fields that blur."""
    return Optics(shot.sensor.fill, shot.lens.blur, shot.lens.olpf)


def _picture(light: Tensor, shot: Shot, plan: Plan, inverse: Tensor, sampled: bool) -> Tensor:
    """The picture as the panel shows it and, for the smooth methods, as blurred as an aperture sees it."""
    if "soften" not in plan and "prefilter" not in plan:
        return light
    coarse = (1 / shot.panel.scale.square() - 1).clamp(min=0) / 6  # a panel of fewer pixels than the picture
    if "prefilter" in plan:
        variance = coarse[:, None, None]
        if not sampled:
            lines = [nodes(torch.arange(n, device=light.device) + 0.5) for n in shot.size]
            variance = variance + _unheld(shot, inverse, lattice(*lines)).amax((1, -1))
        return prefilter(light, enlarge(variance[:, None], shot.size).to(light.dtype), plan.levels)
    variance = coarse[:, None, None]
    if not sampled:
        centre = torch.tensor([[[shot.size[1] / 2, shot.size[0] / 2]]], dtype=torch.float64, device=light.device)
        variance = variance + _unheld(shot, inverse, centre)[:, :, 0]
    across, down = variance.clamp(max=0.5).expand(-1, 3, 2).unbind(-1)
    return spread(light, across, down)


def _unheld(shot: Shot, inverse: Tensor, points: Tensor) -> Tensor:
    """Variance along x and y that `exposure.held` leaves out at image points (1, ..., 2): (B, 3, ..., 2)."""
    layout = as_layout(shot.scene.panel.layout)
    shape = points.shape[1:-1]
    seen = image_to_photo(points.expand(len(shot), *points.shape[1:]).flatten(1, -2), shot.matrix(), shot.size, None)
    j = jacobian(inverse, seen.reshape(len(shot), *shape, 2), shot.size, lens=None)
    seen = exposure.footprint(j, shot.panel.scale / shot.readouts()[0].scale, optics_of(shot))
    side = shot.panel.lit.sqrt().reshape(-1, *[1] * len(shape))
    alpha = shot.panel.scale.reshape(-1, *[1] * len(shape))
    channels = []
    for channel in range(3):
        subpixels = layout.of(channel)
        width = [sum(s.width[i] for s in subpixels) / max(1, len(subpixels)) for i in (0, 1)]
        channels.append(
            torch.stack([exposure.unheld(seen[..., i], width[i] * side, layout.period[i], alpha) for i in (0, 1)], -1)
        )
    return torch.stack(channels, 1)


class Glass(NamedTuple):
    """What a subpixel's light goes through on its way to the sensor, on a lattice of the photo, (B, n, h or 1, w or 1)
    each: the same for all subpixels of one width and height."""

    mean: Tensor  # share of the cell that emits
    amplitude: Tensor | None  # of each harmonic
    slope: Tensor | None  # of the picture between panel pixels, along x and y; see `exposure.held`
    offset: Tensor | None  # and half of what is missing to a slope of 1
    box: Tensor | None  # of the aperture along x and y, in cells; see `exposure.edges`
    sigma: Tensor | None  # of what blurs it, in cells
    width: Tensor  # of the subpixel along x and y, in cells
    reach: Tensor | None  # width of aperture and spread along x and y, in cells, where the screen has edges

    def of(self, rows: slice, size: tuple[int, int]) -> Glass:
        """Some rows of the batch, interpolated to the sensor's lattice where they differ over it."""
        return Glass(*[t if t is None else enlarge(t[rows], size) for t in self])


def _glass(
    s: Subpixel, layout: Layout, shot: Shot, plan: Plan, j: Tensor, dtype: torch.dtype, at: torch.dtype
) -> Glass:
    optics, lit, period = optics_of(shot), shot.panel.lit, j.new_tensor(layout.period)[:, None, None]
    pitch = shot.panel.scale / shot.readouts()[0].scale
    width = j.new_tensor(s.width)[:, None, None] * lit.sqrt()[:, None, None, None] / period
    wide = exposure.footprint(j, pitch, optics).movedim(-1, 1) / period
    amplitude = slope = offset = box = sigma = None
    if plan.exposure == "box":
        box, sigma = ((e.movedim(-1, 1) / period).to(at) for e in exposure.edges(j, pitch, optics))
    if plan.harmonics:
        amplitude = exposure.amplitudes(s, layout.period, plan.harmonics, j, pitch, optics, lit).to(dtype)
    if "panel" in plan:
        slope = exposure.slope(wide, width).to(at)
        offset = 0.5 - 0.5 * slope
    mean = coefficient(s, layout.period, 0, 0, lit).to(dtype)[:, None, None, None]
    reach = None if shot.scene.develop.registered else wide.to(at)
    return Glass(mean, amplitude, slope, offset, box, sigma, width.to(at), reach)


class Place(NamedTuple):
    """Where the subpixels of one kind are. They are counted in cells, from one in the middle of the panel: so a phase
    keeps its digits in float32."""

    cells: Tensor  # (B, 3, 3), from photo coordinates to cells, whole where such a subpixel has its centre
    step: Tensor  # (B, 2, 1, 1) from one cell to the next, along x and y, on a picture from -1 to 1
    start: Tensor  # (B, 2, 1, 1) where on it the pixel is that the subpixel at 0 shows


def _place(s: Subpixel, layout: Layout, shot: Shot, plan: Plan, inverse: Tensor) -> Place:
    alpha, period = shot.panel.scale[:, None], inverse.new_tensor(layout.period)
    pixel = inverse.new_tensor(s.pixel)
    # a panel without stripes has no subpixels that could lie beside their pixel's centre
    centre = pixel if plan.exposure == "mean" else inverse.new_tensor(s.centre)
    middle = (alpha.detach() * inverse.new_tensor(shot.size[::-1]) / (2 * period)).floor() * period
    step = period / alpha
    to_cells = torch.diag_embed(torch.cat([1 / step, torch.ones_like(alpha)], 1))
    to_cells[:, :2, 2] = -(middle + centre) / period
    half = inverse.new_tensor(shot.size[::-1]) / 2
    start = (middle + pixel) / alpha / half - 1
    return Place(to_cells @ inverse, (step / half)[:, :, None, None], start[:, :, None, None])


def _smooth(light: Tensor, shot: Shot, plan: Plan, inverse: Tensor) -> Tensor:
    """content * transmission, summed over subpixels: spectral, box, mean."""
    layout, sites = as_layout(shot.scene.panel.layout), SITES[shot.scene.sensor.cfa]
    rows, cols = (r.positions(light.device) for r in shot.readouts())
    even = plan.affine and shot.bends is None
    points = lattice(rows[:1], cols[:1]) if even else lattice(nodes(rows), nodes(cols))
    j = jacobian(inverse, points, shot.size, lens=shot.bends)
    kinds = [s for channel in range(3) for s in layout.of(channel)]
    dtype, stride = _coordinate_dtype(shot, plan, light.dtype), bayer.stride(shot.scene.sensor.cfa)
    glasses = {s.width: _glass(s, layout, shot, plan, j, light.dtype, dtype) for s in kinds}
    places = {s: _place(s, layout, shot, plan, inverse) for s in kinds}
    lines = [[p[i::stride].to(dtype) for i in range(stride)] for p in (rows, cols)]
    size = len(lines[0][0]), len(lines[1][0])

    def glow(s: Subpixel, members: slice, r: int, c: int, part: slice, local: dict[Any, Glass]) -> Tensor:
        """What the sites at (r, c) of each cell see of one kind of subpixel: (b, channels, h, w)."""
        glass, place = local[s.width], places[s]
        lens = shot.bends and (shot.bends[0][part], shot.bends[1][part])
        q = look(
            place.cells[part], lines[0][r], lines[1][c], shot.size,
            affine=plan.affine, lens=lens, upright=plan.upright,
        )  # fmt: skip
        at = q
        if glass.slope is not None:
            at = [exposure.held(q[i], glass.slope[:, i], glass.offset[:, i]) for i in (0, 1)]
        x, y = (torch.addcmul(place.start[part, i].to(dtype), at[i], place.step[part, i].to(dtype)) for i in (0, 1))
        through = _transmission(glass, plan, q)
        if glass.reach is not None:
            edges = (torch.addcmul(place.start[part, i].to(dtype), q[i], place.step[part, i].to(dtype)) for i in (0, 1))
            widths = (glass.reach[:, i] * place.step[part, i].to(dtype) for i in (0, 1))
            across, down = (exposure.on_screen(at, width) for at, width in zip(edges, widths, strict=True))
            through = through * (across * down).to(through.dtype)
        return exposure.shown(light[part, members], x, y, dark=False) * through[:, None]

    def planes_of(part: slice) -> Tensor:
        local = {width: glass.of(part, size) for width, glass in glasses.items()}
        planes = []
        for r, c, channels in sites:
            seen: dict[int, Tensor] = {}
            for s, members in _shared(layout, channels):
                light_of_s = glow(s, members, r, c, part, local)
                for i, channel in enumerate(range(members.start, members.stop)):
                    seen[channel] = seen[channel] + light_of_s[:, i] if channel in seen else light_of_s[:, i]
            planes += [seen[c] if c in seen else light.new_zeros(len(light[part]), *size) for c in channels]
        return torch.stack(planes, 1)

    at_once = max(1, AT_ONCE // (size[0] * size[1]))
    parts = [planes_of(slice(i, i + at_once)) for i in range(0, max(1, len(shot)), at_once)]
    return parts[0] if len(parts) == 1 else torch.cat(parts)


def _shared(layout: Layout, channels: tuple[int, ...]) -> list[tuple[Subpixel, slice]]:
    """The subpixels that a site reads; where all its channels emit from the same places, they are looked up at once."""
    first = layout.of(channels[0])
    if all([s[1:] for s in layout.subpixels if s[0] == c] == [s[1:] for s in layout.subpixels if s[0] == channels[0]]
           for c in channels):  # fmt: skip
        return [(s, slice(channels[0], channels[-1] + 1)) for s in first]
    return [(s, slice(c, c + 1)) for c in channels for s in layout.of(c)]


def _transmission(glass: Glass, plan: Plan, q: tuple[Tensor, Tensor]) -> Tensor:
    if glass.box is not None:
        across, down = (
            exposure.covered(q[i], *(t[:, i] for t in (glass.box, glass.sigma, glass.width))) for i in (0, 1)
        )
        return (across * down).to(glass.mean.dtype)
    if glass.amplitude is None:
        return glass.mean[:, 0]
    return exposure.spectral(q, glass.mean[:, 0], plan.harmonics, glass.amplitude)


def _sampled(light: Tensor, shot: Shot, plan: Plan, inverse: Tensor) -> Tensor:
    """Panel pixels read at points: point and supersample."""
    layout, sites, readouts = as_layout(shot.scene.panel.layout), SITES[shot.scene.sensor.cfa], shot.readouts()
    rows, cols = (r.positions(light.device) for r in readouts)
    dtype, stride = _coordinate_dtype(shot, plan, light.dtype), bayer.stride(shot.scene.sensor.cfa)
    method, _, n = plan.exposure.partition(":")
    aperture: list[tuple[Any, Any]] = [(0.0, 0.0)]
    if n:
        u = optics_of(shot).quantiles(int(n) ** 2)
        dv, du = (u / r.scale for r in readouts)
        aperture = [(dv[:, i, None], du[:, k, None]) for i, k in exposure.golden(int(n))]
    settings = {
        "layout": layout,
        "alpha": shot.panel.scale,
        "lit": shot.panel.lit,
        "dark": not shot.scene.develop.registered,
    }
    planes = []
    for r, c, channels in sites:
        totals = [torch.zeros((), dtype=light.dtype, device=light.device)] * len(channels)
        for dv, du in aperture:
            v, u = (rows[r::stride] + dv).to(dtype), (cols[c::stride] + du).to(dtype)
            x, y = look(inverse, v, u, shot.size, affine=plan.affine, lens=shot.bends)
            for i, channel in enumerate(channels):
                totals[i] = totals[i] + SAMPLED[method](light[:, channel : channel + 1], channel, x, y, **settings)
        planes += [t / len(aperture) for t in totals]
    return torch.stack(planes, 1)


SAMPLED = {"point": exposure.point, "supersample": exposure.supersample}


def _coordinate_dtype(shot: Shot, plan: Plan, dtype: torch.dtype) -> torch.dtype:
    """float32 where the rounding of coordinates changes no reading by more than half the tolerance, else float64."""
    farthest = max(shot.size) * bounds(shot.scene.panel.scale)[1]
    if plan.exposure in ("spectral", "box", "mean"):  # which count from the middle of the panel
        farthest /= 2
    return dtype if farthest * plan.steepness * torch.finfo(dtype).eps < shot.scene.tolerance / 2 else torch.float64
