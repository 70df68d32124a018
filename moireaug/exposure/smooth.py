"""Panel light integrated over the aperture: the content of the panel pixels it covers, times what
their subpixels let through. Spectral, box and mean differ in the second factor alone."""

from __future__ import annotations

import functools
import math
from abc import abstractmethod
from collections.abc import Iterable
from typing import NamedTuple

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from moireaug.exposure import content
from moireaug.exposure.base import Exposure
from moireaug.exposure.content import Footprint
from moireaug.exposure.filters import through_filters
from moireaug.exposure.optics import Optics, optics_of
from moireaug.exposure.screen import Screen
from moireaug.geometry import grids
from moireaug.geometry.sensor import CFA, Site, cell
from moireaug.numeric import is_transformed
from moireaug.panel.fourier import coefficient, emitting_share, mean_light
from moireaug.scene.layout import Subpixel, as_layout

# readings of one site that are computed together, in bands of rows
AT_ONCE = {"cpu": 2**16, "cuda": 2**22}
MOST_BANDS = 16  # of one site: each fills a gradient of the whole panel
WHOLE_PIXEL = Subpixel(0, (0.5, 0.5), (1.0, 0.0), (0.0, 1.0))


class Sight(NamedTuple):
    """Where sensor pixels look on the panel: position (B, h, w, 2) in panel pixels, float64, and
    its change by sensor pixels along u and v, (B, h, w, 2, 2), in the dtype in which shares are
    worked out."""

    position: Tensor
    step: Tensor


class AlongAxis(NamedTuple):
    """One kind of subpixel along one axis of the panel, as sensor pixels see it."""

    cells: Tensor  # (B, h, w) float64, position in cells from a subpixel's centre
    nearest: Tensor  # (B, h, w) float64, the nearest whole cell
    seen: Footprint  # (B, h, w) each, narrowed to the taps
    width: Tensor  # (B, 1, 1), of the subpixel in cells
    # (B, h, w) of what the view gets from each of the subpixels around, which sum to 1
    share: list[Tensor]
    lit: list[Tensor] | None  # (B, h, w) of each one's light that is there; None where all of it is


class Wave(NamedTuple):
    """A harmonic along one axis of the panel, (B, h, w) each: cycles per sensor pixel along u and
    v, cosine and sine of its phase."""

    fu: Tensor
    fv: Tensor
    cos: Tensor
    sin: Tensor


class SmoothExposure(Exposure):
    """An exposure in closed form, differentiable in the image and in every field of the shot.

    Args:
        taps: see `Exposure`.
        fine: an aperture may be so small a part of a panel's cell that its shares of it need
            float64.
    """

    differentiable_in_shot = True

    def __init__(self, taps: int, *, fine: bool = True) -> None:
        self.taps, self.fine = taps, fine

    def __call__(self, light: Tensor, shot) -> Tensor:
        step, screen = cell(shot.scene.sensor.cfa), Screen(light, shot, self.taps)
        accuracy = torch.float64 if self.fine else light.dtype
        rows, cols = (pixels.positions(light.device) for pixels in shot.sampled_pixels())
        inverse = torch.linalg.inv(shot.matrix())
        read_site = self.read_site
        if shot.requires_grad and torch.is_grad_enabled() and not is_transformed():
            # of a pose's gradient a reading would keep some kilobytes: they are computed again
            read_site = functools.partial(
                checkpoint, self.read_site, use_reentrant=False, preserve_rng_state=False
            )
        planes = []
        for site in CFA[shot.scene.sensor.cfa]:
            across, readings = cols[site.column :: step], []
            for down in rows[site.row :: step].chunk(bands_of(light, shot)):
                readings.append(read_site(site, screen, inverse, down, across, accuracy, shot))
            planes.append(torch.cat(readings, 2))
        return torch.cat(planes, 1)

    def read_site(
        self,
        site: Site,
        screen: Screen,
        inverse: Tensor,
        rows: Tensor,
        cols: Tensor,
        accuracy: torch.dtype,
        shot,
    ) -> Tensor:
        """Return what one site of the filter cell reads at photo coordinates rows x cols:
        (B, channels, h, w).

        inverse: (B, 3, 3), homography from ideal photo to image coordinates.
        """
        sight = look_at_panel(rows, cols, inverse, accuracy, shot)
        return torch.stack(
            through_filters(lambda channel: self.read(screen, channel, sight, shot), site, shot), 1
        )

    @abstractmethod
    def read(self, screen: Screen, channel: int, sight: Sight, shot) -> Tensor:
        """Return what sensor pixels read of one channel: (B, h, w)."""


class BySubpixel(SmoothExposure):
    """An exposure that sums over a channel's subpixels: the panel pixels around, times the share of
    the view filled."""

    def read(self, screen: Screen, channel: int, sight: Sight, shot) -> Tensor:
        layout = as_layout(shot.scene.panel.layout)
        total = torch.zeros_like(sight.position[..., 0], dtype=screen.light.dtype)
        for subpixel in layout.of(channel):
            x, y = (
                along_axis(axis, subpixel, layout.period, sight, shot, screen) for axis in (0, 1)
            )
            through = self.transmission(x, y, subpixel, layout.period, sight, shot)
            total = total + panel_pixels(screen, channel, x, y, subpixel, layout.period) * through
        return total

    @abstractmethod
    def transmission(
        self, x: AlongAxis, y: AlongAxis, subpixel: Subpixel, period, sight: Sight, shot
    ) -> Tensor:
        """Return the share of the view that the subpixels fill, (B, h, w)."""


class Spectral(BySubpixel):
    """The panel's harmonics, each weighted by its modulation transfer: exact in the aperture, the
    lens and the view's local scale."""

    name = "spectral"
    reason = "harmonics by their modulation transfer"

    def __init__(self, taps: int, harmonics: tuple[tuple[int, int], ...], *, fine: bool) -> None:
        super().__init__(taps, fine=fine)
        self.harmonics = harmonics

    def transmission(
        self, x: AlongAxis, y: AlongAxis, subpixel: Subpixel, period, sight: Sight, shot
    ) -> Tensor:
        dtype, optics = x.share[0].dtype, optics_of(shot)
        optics = Optics(*(t.to(dtype) for t in optics))
        width, height = (t.to(dtype)[:, None, None] for t in emitting_share(shot.panel))
        across = {k: wave(k, 0, x, period, sight) for k in {k for k, _ in self.harmonics}}
        down = {l: wave(l, 1, y, period, sight) for l in {l for _, l in self.harmonics}}
        light = coefficient(subpixel, period, 0, 0, width, height).expand(x.cells.shape)
        for k, l in self.harmonics:
            along_x, along_y = across[k], down[l]
            amplitude = 2 * coefficient(subpixel, period, k, l, width, height)
            passed = amplitude * optics.transfer(along_x.fu + along_y.fu, along_x.fv + along_y.fv)
            light = light + passed * (along_x.cos * along_y.cos - along_x.sin * along_y.sin)
        return light


class Box(BySubpixel):
    """The overlap of aperture and subpixels along x and y apart: exact where the view is upright.
    For screens that are magnified beyond what a series can follow."""

    name = "box"
    reason = "the overlap of subpixel and aperture"

    def transmission(
        self, x: AlongAxis, y: AlongAxis, subpixel: Subpixel, period, sight: Sight, shot
    ) -> Tensor:
        return covered(x) * covered(y)


class Mean(SmoothExposure):
    """The panel's mean light alone, so no moiré: the control of every experiment."""

    name = "mean"
    reason = "the panel's mean light alone, so no moiré"

    def read(self, screen: Screen, channel: int, sight: Sight, shot) -> Tensor:
        layout = as_layout(shot.scene.panel.layout)
        share = mean_light(layout, channel, *emitting_share(shot.panel)).to(screen.light.dtype)[
            :, None, None
        ]
        x, y = (along_axis(axis, WHOLE_PIXEL, (1, 1), sight, shot, screen) for axis in (0, 1))
        return panel_pixels(screen, channel, x, y, WHOLE_PIXEL, (1, 1)) * share


def wave(k: int, axis: int, along: AlongAxis, period: tuple[int, int], sight: Sight) -> Wave:
    """Return the k-th harmonic along x (axis 0) or y (axis 1)."""
    dtype = along.share[0].dtype
    fu, fv = (sight.step[..., axis, :] * (k / period[axis])).to(dtype).unbind(-1)
    cycles = k * along.cells
    # whole cycles are dropped before the cast, so that the phase keeps its digits far from the
    # origin
    phase = 2 * math.pi * (cycles - cycles.detach().round()).to(dtype)
    return Wave(fu, fv, torch.cos(phase), torch.sin(phase))


def bands_of(light: Tensor, shot) -> int:
    """Return into how many bands of rows a site's readings are cut, so that memory is bounded."""
    if torch.compiler.is_compiling():
        return 1
    readings = len(light) * math.prod(shot.raw_shape()[-2:])
    return min(MOST_BANDS, 1 + readings // AT_ONCE.get(light.device.type, AT_ONCE["cuda"]))


def look_at_panel(
    rows: Tensor, cols: Tensor, inverse: Tensor, accuracy: torch.dtype, shot
) -> Sight:
    """Return where the sensor pixels at photo coordinates rows x cols look."""
    alpha = shot.panel.scale[:, None, None, None]
    points = grids.grid(rows, cols)
    position = grids.photo_to_image(points, inverse, shot.size, shot.distortion) * alpha
    lens = shot.distortion and tuple(k.to(accuracy) for k in shot.distortion)
    step = grids.jacobian(points.to(accuracy), inverse.to(accuracy), shot.size, lens)
    scale = step.new_tensor([pixels.scale for pixels in shot.sampled_pixels()[::-1]])
    return Sight(position, step * alpha[..., None].to(accuracy) / scale)


def extent(
    subpixel: Subpixel, period: tuple[int, int], axis: int, width: Tensor, height: Tensor
) -> tuple[Tensor, Tensor]:
    """Return a subpixel's width along one axis and the variance that its slant adds, in cells; (B,)
    each."""
    edges = [
        (subpixel.across[axis] * width).abs() / period[axis],
        (subpixel.down[axis] * height).abs() / period[axis],
    ]
    return torch.maximum(*edges), torch.minimum(*edges).square() / 12


def along_axis(
    axis: int, subpixel: Subpixel, period: tuple[int, int], sight: Sight, shot, screen: Screen
) -> AlongAxis:
    """Return one kind of subpixel along x (axis 0) or y (axis 1)."""
    taps, dtype = screen.taps, screen.light.dtype
    cells = (sight.position[..., axis] - subpixel.centre[axis]) / period[axis]
    nearest = cells.detach().round()
    across, down = emitting_share(shot.panel)
    if subpixel is WHOLE_PIXEL:
        across, down = torch.ones_like(across), torch.ones_like(down)
    width, slant = extent(subpixel, period, axis, across, down)
    width, slant = (t.to(sight.step.dtype)[:, None, None] for t in (width, slant))
    seen = content.footprint(sight.step[..., axis, :] / period[axis], optics_of(shot))
    seen = Footprint(seen.box, seen.variance + slant)
    kept, lost = content.fitted(seen, width, taps)
    shares = content.shares((cells - nearest).to(width.dtype), kept, width, taps)
    share = content.normalised([s.to(dtype) for s in shares])
    found = AlongAxis(cells, nearest, kept, width, share, None)
    if shot.scene.develop.registered:
        return found
    ends = shot.panel.scale[:, None, None] * shot.size[1 - axis]
    # a view that was narrowed sees as much of the picture as the whole of it does
    past = (sight.position[..., axis] - ends / 2) / period[axis]
    (whole,) = content.shares(past, Footprint(*(t.double() for t in seen)), ends / period[axis], 1)
    lit = []
    for k in range(-(taps // 2), taps // 2 + 1):
        at = (nearest + k) * period[axis] + subpixel.pixel[axis]
        lit.append(
            torch.where(lost > 0, whole.clamp(min=0), ((at >= 0) & (at < ends)).double()).to(dtype)
        )
    return found._replace(lit=lit)


def covered(along: AlongAxis) -> Tensor:
    """Return the share of a view that subpixels fill along one axis, (B, h, w); the tails past the
    taps, too."""
    every = 4 * len(along.share) + 1
    from_nearest = (along.cells - along.nearest).to(along.width.dtype)
    return _added(content.shares(from_nearest, along.seen, along.width, every)).to(
        along.share[0].dtype
    )


def _added(terms: Iterable[Tensor]) -> Tensor:
    """Return the sum of one tensor or more, each let go as it was added."""
    return functools.reduce(torch.add, terms)


def panel_pixels(
    screen: Screen, channel: int, x: AlongAxis, y: AlongAxis, subpixel: Subpixel, period
) -> Tensor:
    """Return the panel pixels that the subpixels around show, weighted by their shares: (B, h, w).

    In a photo that stays in the camera's frame it is dark past the picture.
    """
    across, down = x.share, y.share
    if x.lit is not None:
        across = [share * lit for share, lit in zip(across, x.lit, strict=True)]
    if y.lit is not None:
        down = [share * lit for share, lit in zip(down, y.lit, strict=True)]
    column, row = (
        (along.nearest - screen.taps // 2) * period[axis] + math.floor(subpixel.pixel[axis])
        for axis, along in enumerate((x, y))
    )
    shown = screen.look(channel, column, row, period)

    def line(j: int) -> Tensor:
        return _added(in_column * shown[j][i] for i, in_column in enumerate(across))

    return _added(in_row * line(j) for j, in_row in enumerate(down))
