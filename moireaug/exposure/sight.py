"""What sensor pixels see of one kind of subpixel, along each axis of the panel."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import torch
from torch import Tensor

from moireaug.exposure import footprints
from moireaug.exposure.footprints import Footprint
from moireaug.exposure.optics import Optics, optics_of
from moireaug.exposure.screen import Screen
from moireaug.geometry import grids
from moireaug.panel.fourier import emitting_share
from moireaug.scene.subpixel import Subpixel
from moireaug.shot import ShotRecord

WHOLE_PIXEL = Subpixel(0, (0.5, 0.5), (1.0, 0.0), (0.0, 1.0))


class Sight(NamedTuple):
    """Where sensor pixels look on the panel: position (B, h, w, 2) in panel pixels, float64, and
    its change per sensor pixel along u and v, (B, h, w, 2, 2), in the dtype in which shares are
    computed."""

    position: Tensor
    step: Tensor


class AlongAxis(NamedTuple):
    """One kind of subpixel along one axis of the panel, as sensor pixels see it."""

    cells: Tensor  # (B, h, w) float64, position in cells from a subpixel's centre
    nearest: Tensor  # (B, h, w) float64, the nearest whole cell
    footprint: Footprint  # (B, h, w) each, narrowed to the taps
    width: Tensor  # (B, 1, 1), width of the subpixel in cells
    share: Tensor  # (taps, B, h, w), shares of the view on the subpixels around, which sum to 1
    lit: Tensor | None  # (taps, B, h, w), share of each that is on the picture; None if all are


def look_at_panel(
    rows: Tensor, cols: Tensor, inverse: Tensor, accuracy: torch.dtype, shot: ShotRecord
) -> Sight:
    """Return where the sensor pixels at photo coordinates rows x cols look on the panel."""
    alpha = shot.panel_scale[:, None, None, None]
    points = grids.grid(rows, cols)
    position = grids.photo_to_image(points, inverse, shot.size, shot.distortion) * alpha
    step = grids.jacobian(points.to(accuracy), inverse.to(accuracy), shot.size, shot.distortion)
    scale = step.new_tensor([pixels.scale for pixels in shot.sampled_pixels()[::-1]])
    return Sight(position, step * alpha[..., None].to(accuracy) / scale)


def footprint_of(
    subpixel: Subpixel, axis: int, step: Tensor, lit: tuple[Tensor, Tensor], optics: Optics
) -> tuple[Footprint, Tensor]:
    """Return what sensor pixels see along x (axis 0) or y (axis 1), (B, h, w) each, and the width
    of a subpixel there, (B, 1, 1); in cells. The slant of a subpixel adds variance to the view.

    Args:
        step: (B, h, w, 2, 2), change in panel pixels per sensor pixel; see `Sight`.
        lit: the shares of the subpixel's width and height that emit light, (B,) each.
        optics: (B,) fields.
    """
    period, (lit_x, lit_y) = subpixel.period[axis], lit
    across = (subpixel.across[axis] * lit_x).abs() / period
    down = (subpixel.down[axis] * lit_y).abs() / period
    width, slant = torch.maximum(across, down), torch.minimum(across, down).square() / 12
    width, slant = (t.to(step.dtype)[:, None, None] for t in (width, slant))
    footprint = footprints.footprint(step[..., axis, :] / period, optics)
    return Footprint(footprint.box, footprint.variance + slant), width


def footprints_of(
    kinds: Iterable[Subpixel], step: Tensor, lit: tuple[Tensor, Tensor], optics: Optics
) -> list[tuple[Footprint, Tensor, int]]:
    """Return `(footprint, width, period)` of each kind of subpixel along x and along y: as
    `footprint_of`, and the cell's period in panel pixels."""
    footprints = []
    for subpixel in kinds:
        for axis, period in enumerate(subpixel.period):
            footprint, width = footprint_of(subpixel, axis, step, lit, optics)
            footprints.append((footprint, width, period))
    return footprints


def along_axis(
    axis: int, subpixel: Subpixel, sight: Sight, shot: ShotRecord, screen: Screen
) -> AlongAxis:
    """Return one kind of subpixel along x (axis 0) or y (axis 1)."""
    across, down = emitting_share(shot.panel)
    if subpixel is WHOLE_PIXEL:
        across, down = torch.ones_like(across), torch.ones_like(down)
    footprint, width = footprint_of(subpixel, axis, sight.step, (across, down), optics_of(shot))
    place = Place(axis, subpixel.centre[axis], subpixel.period[axis], subpixel.pixel[axis])
    return shares_along(place, sight.position[..., axis], footprint, width, shot, screen)


class Place(NamedTuple):
    """Where one kind of subpixel lies along x (axis 0) or y (axis 1), in panel pixels: its centre
    in its cell, the cell's period, and the middle of the panel pixel whose value it shows."""

    axis: int
    centre: float
    period: int
    pixel: float


def shares_along(
    place: Place, at: Tensor, footprint: Footprint, width: Tensor, shot: ShotRecord, screen: Screen
) -> AlongAxis:
    """Return one kind of subpixel along an axis, for sensor pixels at positions `at` (B, h, w) in
    panel pixels; `footprint` and `width` as from `footprint_of`."""
    taps, dtype, period = screen.taps, screen.light.dtype, place.period
    cells = (at - place.centre) / period
    nearest = cells.detach().round()
    narrowed, lost = footprints.fitted(footprint, width, taps)
    shares = footprints.tap_weights((cells - nearest).to(width.dtype), narrowed, width, taps)
    share = footprints.normalised(shares.to(dtype))
    lit = None
    if not shot.scene.develop.registered:
        ends = screen.alpha * shot.size[1 - place.axis]
        pixel = nearest * period + place.pixel
        whole = _share_on_picture(at, footprint, ends, period)
        # a narrowed view sees as much of the picture as the whole view does
        tap = pixel + period * footprints.around(taps, pixel)
        alone = ((tap >= 0) & (tap < ends)).double()
        lit = torch.where(lost > 0, whole, alone).to(dtype)
    return AlongAxis(cells, nearest, narrowed, width, share, lit)


def _share_on_picture(at: Tensor, footprint: Footprint, ends: Tensor, period: int) -> Tensor:
    """Return the share of the views at positions `at` that falls on the picture, which reaches from
    0 to `ends`, (B, h, w) float64; positions in panel pixels."""
    precise = Footprint(*(t.double() for t in footprint))
    (share,) = footprints.tap_weights((at - ends / 2) / period, precise, ends / period, 1)
    return share.clamp(min=0)


def covered(along: AlongAxis) -> Tensor:
    """Return the share of a view that subpixels fill along one axis, (B, h, w), including the tails
    past the taps."""
    every = 4 * len(along.share) + 1
    from_nearest = (along.cells - along.nearest).to(along.width.dtype)
    share = footprints.tap_weights(from_nearest, along.footprint, along.width, every)
    return share.sum(0).to(along.share.dtype)


def panel_pixels(
    screen: Screen, channel: int, x: AlongAxis, y: AlongAxis, subpixel: Subpixel
) -> Tensor:
    """Return the panel pixels that the subpixels around show, weighted by their shares: (B, h, w).

    In a photo in the camera's frame, the panel is dark past the picture.
    """
    across = x.share if x.lit is None else x.share * x.lit
    down = y.share if y.lit is None else y.share * y.lit
    column, row = (
        (along.nearest - screen.taps // 2) * period + math.floor(pixel)
        for along, period, pixel in zip((x, y), subpixel.period, subpixel.pixel, strict=True)
    )
    shown = screen.look(channel, column, row, subpixel.period)
    return (down * (across * shown).sum(1)).sum(0)
