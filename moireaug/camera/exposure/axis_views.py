"""The view of sensor pixels on one kind of subpixel, along each axis of the panel."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import torch
from torch import Tensor

from moireaug.camera.exposure.footprint import (
    Footprint,
    Optics,
    around,
    normalised,
    optics_of,
    tap_weights,
)
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


class AxisShares(NamedTuple):
    """The shares of sensor pixels' views on the subpixels of one kind around them, along one axis
    of the panel."""

    cells: Tensor  # (B, h, w) float64, position in cells from a subpixel's centre
    nearest: Tensor  # (B, h, w) float64, the nearest whole cell
    footprint: Footprint  # (B, h, w) each, narrowed to the taps
    width: Tensor  # (B, 1, 1), width of the subpixel in cells
    share: Tensor  # (taps, B, h, w), shares of the view on the subpixels around, which sum to 1
    # (taps, B, h, w), share of each that is on the picture; None if all are
    on_picture: Tensor | None


def look_at_panel(
    rows: Tensor, cols: Tensor, inverse: Tensor, dtype: torch.dtype, shot: ShotRecord
) -> PanelPoints:
    """Return where the sensor pixels at photo coordinates rows x cols look on the panel."""
    points = grids.grid(rows, cols)
    position = grids.photo_to_image(points, inverse, shot.size, shot.distortion)
    step = panel_steps(points.to(dtype), inverse, shot.distortion, shot)
    return PanelPoints(position * shot.panel_scale[:, None, None, None], step)


def panel_steps(
    points: Tensor, inverse: Tensor, lens: RadialCoefficients | None, shot: ShotRecord
) -> Tensor:
    """Return the change in panel pixels per sensor pixel along u and v at photo points (B or 1, h,
    w, 2): (B, h, w, 2, 2), of their dtype. Other arguments as of `grids.jacobian`."""
    step = grids.jacobian(points, inverse.to(points.dtype), shot.size, lens)
    scale = step.new_tensor([pixels.scale for pixels in shot.sampled_pixels()[::-1]])
    return step * shot.panel_scale[:, None, None, None, None].to(points.dtype) / scale


class AxisView(NamedTuple):
    """The view of one kind of subpixel along one axis of the panel.

    Args:
        footprint: footprint of the view, in cells.
        width: width of the subpixel, in cells.
        period: period of the cells, in panel pixels.
    """

    footprint: Footprint
    width: Tensor
    period: int


def axis_views(scene: SceneRecord, step: Tensor, optics: Optics) -> list[AxisView]:
    """Return the views of each kind of subpixel that a full reading sums, lit all over, along x
    and along y; arguments as of `axis_view`."""
    kinds = scene.panel.cell.all() if scene.shows_pattern else (WHOLE_PIXEL,)
    lit = torch.ones_like(optics.fill)
    return [axis_view(kind, axis, step, (lit, lit), optics) for kind in kinds for axis in (0, 1)]


def axis_view(
    subpixel: Subpixel, axis: int, step: Tensor, lit: tuple[Tensor, Tensor], optics: Optics
) -> AxisView:
    """Return the view of a subpixel along x (axis 0) or y (axis 1), its footprint (B, h, w) each
    and its width (B, 1, 1). The slant of a subpixel adds variance to the view.

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
    return AxisView(Footprint(footprint.box, footprint.variance + slant), width, period)


def variance_beyond_taps(views: Iterable[AxisView], alpha: Tensor | float, taps: int) -> Tensor:
    """Return the most variance that views lose when narrowed to `taps` cells, in squared image
    pixels, of a panel with `alpha` pixels per image pixel."""
    lost = []
    for view in views:
        _, variance = view.footprint.fitted(view.width, taps)
        lost.append(variance * (view.period / alpha) ** 2)
    return torch.stack(lost).amax(0)


def axis_shares(
    axis: int,
    subpixel: Subpixel,
    lit: tuple[Tensor, Tensor],
    points: PanelPoints,
    shot: ShotRecord,
    screen: Screen,
) -> AxisShares:
    """Return the shares of sensor pixels' views on the subpixels of one kind around them, along x
    (axis 0) or y (axis 1); lit: see `axis_view`."""
    view = axis_view(subpixel, axis, points.step, lit, optics_of(shot))
    place = SubpixelPosition(axis, subpixel.centre[axis], view.period, subpixel.pixel[axis])
    at = points.position[..., axis]
    return axis_shares_at(place, at, view.footprint, view.width, shot, screen)


class SubpixelPosition(NamedTuple):
    """Where one kind of subpixel lies along x (axis 0) or y (axis 1), in panel pixels: its centre
    in its cell, the cell's period, and the middle of the panel pixel whose value it shows."""

    axis: int
    centre: float
    period: int
    pixel: float


def axis_shares_at(
    place: SubpixelPosition,
    at: Tensor,
    footprint: Footprint,
    width: Tensor,
    shot: ShotRecord,
    screen: Screen,
) -> AxisShares:
    """Return the AxisShares of views whose middles lie at positions `at` (B, h, w) along the axis,
    in panel pixels; `footprint` and `width` as of an `AxisView`."""
    taps, dtype, period = screen.taps, screen.light.dtype, place.period
    cells = (at - place.centre) / period
    nearest = cells.detach().round()
    narrowed, lost = footprint.fitted(width, taps)
    shares = tap_weights((cells - nearest).to(width.dtype), narrowed, width, taps)
    share = normalised(shares.to(dtype))
    on_picture = None
    if shot.is_dark_around:
        ends = screen.alpha * shot.size[1 - place.axis]
        pixel = nearest * period + place.pixel
        whole = _share_on_picture(at, footprint, ends, period)
        # a narrowed view sees as much of the picture as the whole view does
        tap = pixel + period * around(taps, pixel)
        alone = ((tap >= 0) & (tap < ends)).double()
        on_picture = torch.where(lost > 0, whole, alone).to(dtype)
    return AxisShares(cells, nearest, narrowed, width, share, on_picture)


def _share_on_picture(at: Tensor, footprint: Footprint, ends: Tensor, period: int) -> Tensor:
    """Return the share of the views at positions `at` that falls on the picture, which reaches from
    0 to `ends`, (B, h, w) float64; positions in panel pixels."""
    precise = Footprint(*(t.double() for t in footprint))
    (share,) = tap_weights((at - ends / 2) / period, precise, ends / period, 1)
    return share.clamp(min=0)


def covered_share(shares: AxisShares) -> Tensor:
    """Return the share of a view that subpixels fill along one axis, (B, h, w), including the tails
    past the taps."""
    every = 4 * len(shares.share) + 1
    from_nearest = (shares.cells - shares.nearest).to(shares.width.dtype)
    share = tap_weights(from_nearest, shares.footprint, shares.width, every)
    return share.sum(0).to(shares.share.dtype)


def panel_pixels(
    screen: Screen, channel: int, x: AxisShares, y: AxisShares, subpixel: Subpixel
) -> Tensor:
    """Return the panel pixels that the subpixels around show, weighted by their shares: (B, h, w).

    In a photo in the camera's frame, the panel is dark past the picture.
    """
    across = x.share if x.on_picture is None else x.share * x.on_picture
    down = y.share if y.on_picture is None else y.share * y.on_picture
    column, row = (
        (axis.nearest - screen.taps // 2) * period + math.floor(pixel)
        for axis, period, pixel in zip((x, y), subpixel.period, subpixel.pixel, strict=True)
    )
    light = screen.look(channel, column, row, subpixel.period)
    return (down * (across * light).sum(1)).sum(0)
