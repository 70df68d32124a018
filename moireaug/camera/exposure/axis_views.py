"""The view of sensor pixels on one kind of subpixel, along each axis of the panel."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import torch
from torch import Tensor

from moireaug.camera.exposure.footprint import Footprint, Optics, around, normalised, tap_weights
from moireaug.camera.exposure.screen import Screen
from moireaug.scene.geometry import grids
from moireaug.scene.geometry.grids import RadialCoefficients
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord
from moireaug.scene.subpixel import Subpixel

WHOLE_PIXEL = Subpixel(0, (0.5, 0.5), (1.0, 0.0), (0.0, 1.0))


class PanelPoints(NamedTuple):
    """Where sensor pixels look on the panel: position (B, h, w, 2) in panel pixels, float64, and
    its change per sensor pixel along u and v, (B, h, w, 2, 2), in the dtype in which shares are
    computed."""

    position: Tensor
    step: Tensor


class AxisView(NamedTuple):
    """The view of sensor pixels on one kind of subpixel along x (axis 0) or y (axis 1).

    Args:
        footprint: of the view, (B, h, w) each, in cells.
        width: of the subpixel, (B, 1, 1), in cells; `subpixel` says where it lies.
    """

    subpixel: Subpixel
    axis: int
    footprint: Footprint
    width: Tensor

    @property
    def period(self) -> int:
        """Panel pixels along the axis from one copy of the subpixel to the next."""
        return self.subpixel.period[self.axis]

    @property
    def pixel(self) -> float:
        """Where along the axis the middle of the panel pixel lies whose value it shows."""
        return self.subpixel.pixel[self.axis]


class AxisShares(NamedTuple):
    """The shares of sensor pixels' views on the subpixels of one kind around them, along one axis
    of the panel.

    Args:
        cells: (B, h, w) float64, position in cells from a subpixel's centre. nearest: the nearest
            whole cell.
        view: the AxisView, narrowed to the taps.
        share: (taps, B, h, w), shares of the view on the subpixels around, which sum to 1.
        on_picture: (taps, B, h, w), share of each that is on the picture; None if all are.
    """

    cells: Tensor
    nearest: Tensor
    view: AxisView
    share: Tensor
    on_picture: Tensor | None


def look_at_panel(rows: Tensor, cols: Tensor, dtype: torch.dtype, shot: ShotRecord) -> PanelPoints:
    """Return where the sensor pixels at photo coordinates rows x cols look on the panel."""
    points = grids.grid(rows, cols)
    position = grids.photo_to_image(points, shot.inverse_matrix(), shot.size, shot.distortion)
    step = panel_steps(points.to(dtype), shot.distortion, shot)
    return PanelPoints(position * shot.panel_scale[:, None, None, None], step)


def panel_steps(points: Tensor, lens: RadialCoefficients | None, shot: ShotRecord) -> Tensor:
    """Return the change in panel pixels per sensor pixel along u and v at photo points (B or 1, h,
    w, 2): (B, h, w, 2, 2), of their dtype. lens: as of `grids.jacobian`."""
    step = grids.jacobian(points, shot.inverse_matrix().to(points.dtype), shot.size, lens)
    scale = step.new_tensor([pixels.scale for pixels in shot.sampled_pixels()[::-1]])
    return step * shot.panel_scale[:, None, None, None, None].to(points.dtype) / scale


def axis_views(scene: SceneRecord, step: Tensor, optics: Optics) -> list[AxisView]:
    """Return the views of each kind of subpixel that a full reading sums, lit all over, along x
    and along y; arguments as of `axis_view`."""
    kinds = scene.panel.cell.all() if scene.shows_pattern else (WHOLE_PIXEL,)
    lit = torch.ones_like(optics.fill)
    return [axis_view(kind, axis, step, (lit, lit), optics) for kind in kinds for axis in (0, 1)]


def axis_view(
    subpixel: Subpixel, axis: int, step: Tensor, lit: tuple[Tensor, Tensor], optics: Optics
) -> AxisView:
    """Return the view of a subpixel along x (axis 0) or y (axis 1), to which its slant adds
    variance.

    Args:
        step: (B, h, w, 2, 2), change in panel pixels per sensor pixel; see `PanelPoints`.
        lit: the shares of the subpixel's width and height that emit light, (B,) each.
        optics: (B,) fields.
    """
    period, (lit_x, lit_y) = subpixel.period[axis], lit
    across = (subpixel.across[axis] * lit_x).abs() / period
    down = (subpixel.down[axis] * lit_y).abs() / period
    width, slant = torch.maximum(across, down), torch.minimum(across, down).square() / 12
    width, slant = (t.to(step.dtype)[:, None, None] for t in (width, slant))
    footprint = Footprint.of(step[..., axis, :] / period, optics)
    footprint = Footprint(footprint.box, footprint.variance + slant)
    return AxisView(subpixel, axis, footprint, width)


def variance_beyond_taps(views: Iterable[AxisView], alpha: Tensor | float, taps: int) -> Tensor:
    """Return the most variance that views lose when narrowed to `taps` cells, in squared image
    pixels, of a panel with `alpha` pixels per image pixel."""
    lost = []
    for view in views:
        _, variance = view.footprint.fitted(view.width, taps)
        lost.append(variance * (view.period / alpha) ** 2)
    return torch.stack(lost).amax(0)


def axis_shares(view: AxisView, at: Tensor, shot: ShotRecord, screen: Screen) -> AxisShares:
    """Return the shares on the subpixels around of views whose middles lie at positions `at`
    (B, h, w) along their axis, in panel pixels."""
    taps, dtype, period, width = screen.taps, screen.light.dtype, view.period, view.width
    cells = (at - view.subpixel.centre[view.axis]) / period
    nearest = cells.detach().round()
    narrowed, lost = view.footprint.fitted(width, taps)
    shares = tap_weights((cells - nearest).to(width.dtype), narrowed, width, taps)
    share = normalised(shares.to(dtype))
    on_picture = None
    if shot.is_dark_around:
        ends = screen.alpha * shot.size[1 - view.axis]
        pixel = nearest * period + view.pixel
        whole = _share_on_picture(at, view.footprint, ends, period)
        # a narrowed view sees as much of the picture as the whole view does
        tap = pixel + period * around(taps, pixel)
        alone = ((tap >= 0) & (tap < ends)).double()
        on_picture = torch.where(lost > 0, whole, alone).to(dtype)
    return AxisShares(cells, nearest, view._replace(footprint=narrowed), share, on_picture)


def _share_on_picture(at: Tensor, footprint: Footprint, ends: Tensor, period: int) -> Tensor:
    """Return the share of the views at positions `at` that falls on the picture, which reaches from
    0 to `ends`, (B, h, w) float64; positions in panel pixels."""
    precise = Footprint(*(t.double() for t in footprint))
    (share,) = tap_weights((at - ends / 2) / period, precise, ends / period, 1)
    return share.clamp(min=0)


def covered_share(shares: AxisShares) -> Tensor:
    """Return the share of a view that subpixels fill along one axis, (B, h, w), including the tails
    past the taps."""
    every, view = 4 * len(shares.share) + 1, shares.view
    from_nearest = (shares.cells - shares.nearest).to(view.width.dtype)
    share = tap_weights(from_nearest, view.footprint, view.width, every)
    return share.sum(0).to(shares.share.dtype)


def panel_pixels(screen: Screen, channel: int, x: AxisShares, y: AxisShares) -> Tensor:
    """Return the panel pixels that the subpixels around show, weighted by their shares: (B, h, w).

    In a photo in the camera's frame, the panel is dark past the picture.
    """
    across, down = (
        axis.share if axis.on_picture is None else axis.share * axis.on_picture for axis in (x, y)
    )
    column, row = (
        (axis.nearest - screen.taps // 2) * axis.view.period + math.floor(axis.view.pixel)
        for axis in (x, y)
    )
    light = screen.look(channel, column, row, (x.view.period, y.view.period))
    return (down * (across * light).sum(1)).sum(0)
