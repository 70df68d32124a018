"""Panel light integrated over every sensor pixel that a photo reads: the exposure of a plan, for a whole batch."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

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

AT_ONCE = 2**17  # sensor pixels of one colour that are worked on together on CPU: what a processor's cache holds


def in_parts(f: Callable[[Tensor, Shot, slice], Tensor], batch: Tensor, shot: Shot) -> Tensor:
    """f of some rows of a batch, of their shot and of which they are, for all of them. A GPU and a compiler take the
    batch whole."""
    n = max(1, AT_ONCE // math.prod(shot.raw_shape()[-2:]))
    if n >= len(batch) or batch.device.type != "cpu" or torch.compiler.is_compiling():
        return f(batch, shot, slice(None))
    rows = [slice(i, i + n) for i in range(0, len(batch), n)]
    return torch.cat([f(part, shot[r], r) for part, r in zip(batch.split(n), rows, strict=True)])


def integral(shot: Shot, plan: Plan, dtype: torch.dtype) -> Callable[[Tensor, slice], Tensor]:
    """What takes the panel light (b, 3, H, W) of some rows of the batch to the readings of each sensor pixel, packed
    planes (b, 4 or 3, h, w). What is coarse is computed here, for the whole batch."""
    if "exposure" not in plan:
        return lambda light, rows: light
    inverse = torch.linalg.inv(shot.matrix())
    sampled = plan.exposure == "point" or plan.exposure.startswith("supersample")
    blur = _blur(shot, plan, inverse, sampled)
    read = (_sampled if sampled else _smooth)(shot, plan, inverse, dtype)
    return lambda light, rows: read(blur(light, rows), rows)


def optics_of(shot: Shot) -> Optics:
    """The drawn fields that blur."""
    return Optics(shot.sensor.fill, shot.lens.blur, shot.lens.olpf)


def _blur(shot: Shot, plan: Plan, inverse: Tensor, sampled: bool) -> Callable[[Tensor, slice], Tensor]:
    """The picture as the panel shows it and, for the smooth methods, as blurred as an aperture sees it."""
    if "soften" not in plan and "prefilter" not in plan:
        return lambda light, rows: light
    coarse = (1 / shot.panel.scale.square() - 1).clamp(min=0) / 6  # a panel of fewer pixels than the picture
    variance = coarse[:, None, None]
    if "prefilter" in plan:
        if not sampled:
            lines = [nodes(torch.arange(n, device=inverse.device) + 0.5) for n in shot.size]
            variance = variance + _unheld(shot, inverse, lattice(*lines)).amax((1, -1))
        variance = variance[:, None]
        return lambda light, rows: prefilter(light, enlarge(variance[rows], shot.size).to(light.dtype), plan.levels)
    if not sampled:
        centre = torch.tensor([[[shot.size[1] / 2, shot.size[0] / 2]]], dtype=torch.float64, device=inverse.device)
        variance = variance + _unheld(shot, inverse, centre)[:, :, 0]
    across, down = variance.clamp(max=0.5).expand(-1, 3, 2).unbind(-1)
    return lambda light, rows: spread(light, across[rows], down[rows])


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
    step: tuple[Tensor, Tensor]  # (B, 1, 1), from one cell to the next, along x and y, on a picture from -1 to 1
    start: tuple[Tensor, Tensor]  # (B, 1, 1), where on it the pixel is that the subpixel at 0 shows

    def of(self, rows: slice) -> Place:
        return Place(self.cells[rows], *(tuple(t[rows] for t in pair) for pair in (self.step, self.start)))

    def on_picture(self, q: Sequence[Tensor]) -> list[Tensor]:
        """Where the pixels are that the subpixels at q show, as `exposure.shown` takes it."""
        return [t * step + start for t, step, start in zip(q, self.step, self.start, strict=True)]


def _place(s: Subpixel, layout: Layout, shot: Shot, plan: Plan, inverse: Tensor, at: torch.dtype) -> Place:
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
    step, start = (tuple(t.to(at)[:, :, None, None].unbind(1)) for t in (step / half, start))
    return Place(to_cells @ inverse, step, start)


def _smooth(shot: Shot, plan: Plan, inverse: Tensor, dtype: torch.dtype) -> Callable[[Tensor, slice], Tensor]:
    """content * transmission, summed over subpixels: spectral, box, mean."""
    layout, sites = as_layout(shot.scene.panel.layout), SITES[shot.scene.sensor.cfa]
    rows, cols = (r.positions(inverse.device) for r in shot.readouts())
    even = plan.affine and shot.bends is None
    points = lattice(rows[:1], cols[:1]) if even else lattice(nodes(rows), nodes(cols))
    j = jacobian(inverse, points, shot.size, lens=shot.bends)
    kinds = [s for channel in range(3) for s in layout.of(channel)]
    at, stride = _coordinate_dtype(shot, plan, dtype), bayer.stride(shot.scene.sensor.cfa)
    glasses = {w: _glass(s, layout, shot, plan, j, dtype, at) for w, s in {s.width: s for s in kinds}.items()}
    places = {s: _place(s, layout, shot, plan, inverse, at) for s in kinds}
    lines = [[p[i::stride].to(at) for i in range(stride)] for p in (rows, cols)]
    size = len(lines[0][0]), len(lines[1][0])

    def read(light: Tensor, part: slice) -> Tensor:
        local = {width: glass.of(part, size) for width, glass in glasses.items()}
        lens = shot.bends and tuple(k[part] for k in shot.bends)

        def glow(s: Subpixel, members: slice, r: int, c: int) -> Tensor:
            """What the sites at (r, c) of each cell see of one kind of subpixel: (b, channels, h, w)."""
            glass, place = local[s.width], places[s].of(part)
            q = look(
                place.cells, lines[0][r], lines[1][c], shot.size, affine=plan.affine, lens=lens, upright=plan.upright
            )
            through = _transmission(glass, plan, q)
            if glass.reach is not None:
                ends = zip(place.on_picture(q), glass.reach.unbind(1), place.step, strict=True)
                across, down = (exposure.on_screen(at, reach * step) for at, reach, step in ends)
                through = through * (across * down).to(through.dtype)
            if glass.slope is not None:
                q = [exposure.held(t, glass.slope[:, i], glass.offset[:, i]) for i, t in enumerate(q)]
            return exposure.shown(light[:, members], *place.on_picture(q), dark=False) * through[:, None]

        planes = []
        for r, c, channels in sites:
            seen: dict[int, Tensor] = {}
            for s, members in _shared(layout, channels):
                light_of_s = glow(s, members, r, c)
                for i, channel in enumerate(range(members.start, members.stop)):
                    seen[channel] = seen[channel] + light_of_s[:, i] if channel in seen else light_of_s[:, i]
            planes += [seen[c] if c in seen else light.new_zeros(len(light), *size) for c in channels]
        return torch.stack(planes, 1)

    return read


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


def _sampled(shot: Shot, plan: Plan, inverse: Tensor, dtype: torch.dtype) -> Callable[[Tensor, slice], Tensor]:
    """Panel pixels read at points: point and supersample."""
    layout, sites, readouts = as_layout(shot.scene.panel.layout), SITES[shot.scene.sensor.cfa], shot.readouts()
    lines = [r.positions(inverse.device) for r in readouts]
    at, stride = _coordinate_dtype(shot, plan, dtype), bayer.stride(shot.scene.sensor.cfa)
    method, _, n = plan.exposure.partition(":")
    offsets = optics_of(shot).quantiles(int(n) ** 2) if n else inverse.new_zeros(len(shot), 1)
    down, across = (offsets / r.scale for r in readouts)
    aperture = exposure.golden(int(n or 1))

    def read(light: Tensor, part: slice) -> Tensor:
        lens = shot.bends and tuple(k[part] for k in shot.bends)
        settings = {
            "layout": layout,
            "alpha": shot.panel.scale[part],
            "lit": shot.panel.lit[part],
            "dark": not shot.scene.develop.registered,
        }
        planes = []
        for r, c, channels in sites:
            totals = [torch.zeros((), dtype=dtype, device=light.device)] * len(channels)
            for i, k in aperture:
                v = (lines[0][r::stride] + down[part, i, None]).to(at)
                u = (lines[1][c::stride] + across[part, k, None]).to(at)
                x, y = look(inverse[part], v, u, shot.size, affine=plan.affine, lens=lens)
                for j, channel in enumerate(channels):
                    seen = SAMPLED[method](light[:, channel : channel + 1], channel, x, y, **settings)
                    totals[j] = totals[j] + seen
            planes += [t / len(aperture) for t in totals]
        return torch.stack(planes, 1)

    return read


SAMPLED = {"point": exposure.point, "supersample": exposure.supersample}


def _coordinate_dtype(shot: Shot, plan: Plan, dtype: torch.dtype) -> torch.dtype:
    """float32 where the rounding of coordinates changes no reading by more than half the tolerance, else float64."""
    farthest = max(shot.size) * bounds(shot.scene.panel.scale)[1]
    if plan.exposure in ("spectral", "box", "mean"):  # which count from the middle of the panel
        farthest /= 2
    return dtype if farthest * plan.steepness * torch.finfo(dtype).eps < shot.scene.tolerance / 2 else torch.float64
