"""Panel light integrated over the aperture: the content of the panel pixels it covers, times what their subpixels let
through. Spectral, box and mean differ in the second factor alone."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from moireaug.exposure import content
from moireaug.exposure.base import Exposure
from moireaug.exposure.content import Footprint
from moireaug.exposure.optics import Optics, optics_of
from moireaug.geometry import grids
from moireaug.geometry.sensor import CFA, cell
from moireaug.panel.fourier import coefficient, emitting_share, mean_light
from moireaug.scene.fields import bounds
from moireaug.scene.layout import Subpixel, as_layout

LOOKS = 1  # panel pixels, for each that is looked at, up to which a panel is built
WHOLE_PIXEL = Subpixel(0, (0.5, 0.5), (1.0, 0.0), (0.0, 1.0))


class Sight(NamedTuple):
    """Where sensor pixels look on the panel, float64: position (B, h, w, 2) in panel pixels, and its change by sensor
    pixels along u and v, (B, h, w, 2, 2)."""

    position: Tensor
    step: Tensor


class AlongAxis(NamedTuple):
    """One kind of subpixel along one axis of the panel, as sensor pixels see it."""

    cells: Tensor  # (B, h, w) float64, position in cells from a subpixel's centre
    nearest: Tensor  # (B, h, w) float64, the nearest whole cell
    seen: Footprint  # (B, h, w) float64 each, narrowed to the taps
    width: Tensor  # (B, 1, 1) float64, of the subpixel in cells
    share: Tensor  # (B, h, w, taps) of what the view gets from each of the subpixels around, which sum to 1
    lit: Tensor | None  # (B, h, w, taps) of each one's light that is there; None where all of it is


class SmoothExposure(Exposure):
    """An exposure in closed form, differentiable in the image and in every field of the shot."""

    differentiable_in_shot = True

    def __init__(self, taps: int) -> None:
        self.taps = taps

    def __call__(self, light: Tensor, shot) -> Tensor:
        step = cell(shot.scene.sensor.cfa)
        rows, cols = (pixels.positions(light.device) for pixels in shot.sampled_pixels())
        planes = []
        for site in CFA[shot.scene.sensor.cfa]:
            sight = look_at_panel(rows[site.row :: step], cols[site.column :: step], shot)
            planes += [self.read(light[:, channel], channel, sight, shot) for channel in site.channels]
        return torch.stack(planes, 1)

    def read(self, plane: Tensor, channel: int, sight: Sight, shot) -> Tensor:
        """Return what sensor pixels read of one channel (B, H, W): (B, h, w)."""
        layout = as_layout(shot.scene.panel.layout)
        total = torch.zeros(sight.position.shape[:3], dtype=plane.dtype, device=plane.device)
        for subpixel in layout.of(channel):
            total = total + self.read_subpixel(plane, subpixel, layout.period, sight, shot)
        return total

    def read_subpixel(self, plane: Tensor, subpixel: Subpixel, period: tuple[int, int], sight: Sight, shot) -> Tensor:
        """Return what sensor pixels read of one kind of subpixel."""
        x, y = (along_axis(axis, subpixel, period, sight, self.taps, shot, plane.dtype) for axis in (0, 1))
        through = self.transmission(x, y, subpixel, period, sight, shot)
        return panel_pixels(plane, x, y, subpixel, period, shot) * through

    def transmission(self, x: AlongAxis, y: AlongAxis, subpixel: Subpixel, period, sight: Sight, shot) -> Tensor:
        """Return the share of the view that the subpixels fill, (B, h, w)."""
        raise NotImplementedError


class Spectral(SmoothExposure):
    """The panel's harmonics, each weighted by its modulation transfer: exact in the aperture, the lens and the view's
    local scale."""

    name = "spectral"
    reason = "harmonics by their modulation transfer"

    def __init__(self, taps: int, harmonics: tuple[tuple[int, int], ...]) -> None:
        super().__init__(taps)
        self.harmonics = harmonics

    def transmission(self, x: AlongAxis, y: AlongAxis, subpixel: Subpixel, period, sight: Sight, shot) -> Tensor:
        dtype, optics = x.share.dtype, optics_of(shot)
        optics = Optics(*(t.to(dtype) for t in optics))
        width, height = (t.to(dtype)[:, None, None] for t in emitting_share(shot.panel))
        step = sight.step.to(dtype)
        light = coefficient(subpixel, period, 0, 0, width, height).expand(x.cells.shape)
        for k, l in self.harmonics:
            frequency = k / period[0] * step[..., 0, :] + l / period[1] * step[..., 1, :]
            amplitude = 2 * coefficient(subpixel, period, k, l, width, height)
            amplitude = amplitude * optics.transfer(frequency[..., 0], frequency[..., 1])
            cycles = k * x.cells + l * y.cells
            # whole cycles are dropped before the cast, so that the phase keeps its digits far from the origin
            phase = (cycles - cycles.detach().round()).to(dtype)
            light = light + amplitude * torch.cos(2 * math.pi * phase)
        return light


class Box(SmoothExposure):
    """The overlap of aperture and subpixels along x and y apart: exact where the view is upright. For screens that are
    magnified beyond what a series can follow."""

    name = "box"
    reason = "the overlap of subpixel and aperture"

    def transmission(self, x: AlongAxis, y: AlongAxis, subpixel: Subpixel, period, sight: Sight, shot) -> Tensor:
        return covered(x).to(x.share.dtype) * covered(y).to(y.share.dtype)


class Mean(SmoothExposure):
    """The panel's mean light alone, so no moiré: the control of every experiment."""

    name = "mean"
    reason = "the panel's mean light alone, so no moiré"

    def read(self, plane: Tensor, channel: int, sight: Sight, shot) -> Tensor:
        layout = as_layout(shot.scene.panel.layout)
        share = mean_light(layout, channel, *emitting_share(shot.panel)).to(plane.dtype)[:, None, None]
        x, y = (along_axis(axis, WHOLE_PIXEL, (1, 1), sight, self.taps, shot, plane.dtype) for axis in (0, 1))
        return panel_pixels(plane, x, y, WHOLE_PIXEL, (1, 1), shot) * share


def look_at_panel(rows: Tensor, cols: Tensor, shot) -> Sight:
    """Return where the sensor pixels at photo coordinates rows x cols look."""
    alpha, inverse = shot.panel.scale[:, None, None, None], torch.linalg.inv(shot.matrix())
    points = grids.grid(rows, cols)
    position = grids.photo_to_image(points, inverse, shot.size, shot.distortion) * alpha
    step = grids.jacobian(points, inverse, shot.size, shot.distortion)
    scale = rows.new_tensor([pixels.scale for pixels in shot.sampled_pixels()[::-1]])
    return Sight(position, step * alpha[..., None] / scale)


def extent(subpixel: Subpixel, period: tuple[int, int], axis: int, width: Tensor, height: Tensor) -> tuple:
    """Return a subpixel's width along one axis and the variance that its slant adds, in cells; (B,) each."""
    edges = [(subpixel.across[axis] * width).abs() / period[axis], (subpixel.down[axis] * height).abs() / period[axis]]
    return torch.maximum(*edges), torch.minimum(*edges).square() / 12


def along_axis(
    axis: int, subpixel: Subpixel, period: tuple[int, int], sight: Sight, taps: int, shot, dtype: torch.dtype
) -> AlongAxis:
    """Return one kind of subpixel along x (axis 0) or y (axis 1)."""
    cells = (sight.position[..., axis] - subpixel.centre[axis]) / period[axis]
    nearest = cells.detach().round()
    shown = (torch.ones_like(t) for t in emitting_share(shot.panel))
    if subpixel is not WHOLE_PIXEL:
        shown = emitting_share(shot.panel)
    width, slant = extent(subpixel, period, axis, *shown)
    seen = content.footprint(sight.step[..., axis, :] / period[axis], optics_of(shot))
    seen = Footprint(seen.box, seen.variance + slant[:, None, None])
    width = width[:, None, None]
    kept, lost = content.fitted(seen, width, taps)
    # in float64: of a magnified panel, or through a pinhole, shares are small differences of large numbers
    share = content.normalised(content.shares(cells - nearest, kept, width, taps)).to(dtype)
    found = AlongAxis(cells, nearest, kept, width, share, None)
    if shot.scene.develop.registered:
        return found
    ends = shot.panel.scale[:, None, None, None] * shot.size[1 - axis]
    around = torch.arange(taps, dtype=torch.float64, device=share.device) - taps // 2
    at = (nearest[..., None] + around) * period[axis] + subpixel.pixel[axis]
    lit = ((at >= 0) & (at < ends)).to(dtype)
    # a view that was narrowed sees as much of the picture as the whole of it does
    past = (sight.position[..., axis] - ends[..., 0] / 2) / period[axis]
    whole = content.shares(past, seen, ends[..., 0] / period[axis], 1).clamp(min=0)
    return found._replace(lit=torch.where(lost[..., None] > 0, whole.to(dtype), lit))


def covered(along: AlongAxis) -> Tensor:
    """Return the share of a view that subpixels fill along one axis, (B, h, w) float64; tails past the taps, too."""
    every = 4 * along.share.shape[-1] + 1
    return content.shares(along.cells - along.nearest, along.seen, along.width, every).sum(-1)


def panel_pixels(plane: Tensor, x: AlongAxis, y: AlongAxis, subpixel: Subpixel, period, shot) -> Tensor:
    """Return the panel pixels that the subpixels around show, weighted by their shares: (B, h, w).

    A panel pixel has the picture's value at its centre. Past the picture its border goes on; in a photo that stays in
    the camera's frame it is dark there.
    """
    taps = x.share.shape[-1]
    across = x.share if x.lit is None else x.share * x.lit
    down = y.share if y.lit is None else y.share * y.lit
    around = range(-(taps // 2), taps // 2 + 1)
    columns = [x.nearest * period[0] + (math.floor(subpixel.pixel[0]) + k * period[0]) for k in around]
    rows = [y.nearest * period[1] + (math.floor(subpixel.pixel[1]) + k * period[1]) for k in around]
    shown, total = what_is_shown(plane, columns, rows, shot), 0.0
    for j in range(taps):
        line = 0.0
        for i in range(taps):
            line = line + across[..., i] * shown(i, j)
        total = total + down[..., j] * line
    return total


def what_is_shown(plane: Tensor, columns: list[Tensor], rows: list[Tensor], shot) -> Callable[[int, int], Tensor]:
    """Return a function that gives what the panel pixels at columns[i] and rows[j] show, (B, h, w): the picture at
    their centres.

    The picture is put on the panel once, and its pixels gathered, unless the panel has more of them than are looked at.
    """
    alpha = shot.panel.scale[:, None, None]
    most = bounds(shot.scene.panel.scale)[1]
    if len(alpha) and not torch.compiler.is_compiling():
        most = float(alpha.detach().max())
    h, w = (math.ceil(most * n) + 2 for n in shot.size)
    if h * w > LOOKS * len(rows) * len(columns) * columns[0][:1].numel():
        return lambda i, j: grids.look_up(plane[:, None], (columns[i] + 0.5) / alpha, (rows[j] + 0.5) / alpha)[:, 0]
    panel = on_panel(plane, h, w, alpha).flatten(1)
    columns = [(column.long() + 1).clamp(0, w - 1) for column in columns]
    rows = [(row.long() + 1).clamp(0, h - 1) * w for row in rows]
    return lambda i, j: panel.gather(1, (rows[j] + columns[i]).flatten(1)).reshape(rows[j].shape)


def on_panel(plane: Tensor, h: int, w: int, alpha: Tensor) -> Tensor:
    """Return what the panel's pixels show of one channel (B, H, W): its values at their centres, (B, h, w), from one
    pixel before the picture, which has its border."""
    y, x = (torch.arange(n, dtype=alpha.dtype, device=alpha.device) - 0.5 for n in (h, w))
    x, y = torch.broadcast_tensors(x / alpha, y[:, None] / alpha)
    return grids.look_up(plane[:, None], x, y)[:, 0]
