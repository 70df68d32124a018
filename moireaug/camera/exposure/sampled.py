"""Panel light read at points: at the pixel's centre, as the paper does, or averaged over its
aperture."""

from __future__ import annotations

from abc import abstractmethod

import torch
from torch import Tensor

from moireaug.camera.exposure.filters import filter_cell_seen, through_filters
from moireaug.camera.exposure.footprint import optics_of
from moireaug.camera.exposure.screen import DisplayedPicture
from moireaug.camera.panel import cell_of, emits, emitting_share
from moireaug.scene.exposure_method import ExposureMethod
from moireaug.scene.geometry import grids
from moireaug.scene.geometry.lattice import CFA, pattern_period
from moireaug.scene.shot import ShotRecord
from moireaug.scene.subpixel import Subpixel

MAX_POINTS_AT_ONCE = 2**14  # of an image, over the sensor pixels of one site; at least one a pixel


class Sampled(ExposureMethod):
    """The mean of the panel's light at some points around each sensor pixel's centre."""

    def __call__(self, light: Tensor, shot: ShotRecord) -> Tensor:
        pixels, alpha = shot.sampled_pixels(), shot.panel_scale[:, None, None]
        rows, cols = (axis.positions(light.device) for axis in pixels)
        picture, offsets = DisplayedPicture(light, shot), self.offsets(shot)
        down, across = offsets[:, 0] / pixels[0].scale, offsets[:, 1] / pixels[1].scale
        inverse, cfa = shot.inverse_matrix(), filter_cell_seen(shot)
        period, planes = pattern_period(cfa), []
        for site in CFA[cfa]:
            row, column = rows[site.row :: period], cols[site.column :: period]
            total = light.new_zeros(())
            at_once = max(1, MAX_POINTS_AT_ONCE // max(1, len(row) * len(column)))
            for v_offsets, u_offsets in zip(
                down.split(at_once, 1), across.split(at_once, 1), strict=True
            ):
                v, u = row + v_offsets[..., None], column + u_offsets[..., None]
                points = grids.grid(v.flatten(0, 1), u.flatten(0, 1))
                # the grids of these points stacked along v
                points = points.unflatten(0, v_offsets.shape).flatten(1, 2)
                points_on_image = grids.photo_to_image(points, inverse, shot.size, shot.distortion)
                x, y = (points_on_image * alpha[..., None]).unbind(-1)
                readings = [self.read(picture, x, y, shot, channel) for channel in site.channels]
                plane = torch.stack(readings, 1)
                total = total + plane.unflatten(2, (v_offsets.shape[1], len(row))).sum(2)
            planes.append(total / offsets.shape[2])
        return through_filters(torch.cat(planes, 1), shot)

    @abstractmethod
    def offsets(self, shot: ShotRecord) -> Tensor:
        """Return the points of each sensor pixel, (B, 2, N) float64, down and across from its
        centre in sensor pixels."""

    @abstractmethod
    def read(
        self, picture: DisplayedPicture, x: Tensor, y: Tensor, shot: ShotRecord, channel: int
    ) -> Tensor:
        """Return one channel's light at panel positions x, y (B, h, w): (B, h, w)."""


class Point(Sampled):
    """The panel's raster of subpixels at each sensor pixel's centre, bilinear: the paper's steps 2
    and 3.

    Where two raster rows or columns show different panel pixels, the picture is looked up between
    these. This equals the paper's own interpolation where image pixels are a whole odd number of
    panel pixels wide, as they are there.
    """

    name = "point"
    has_aperture = False

    def __init__(self, *, has_black_matrix: bool) -> None:
        self.reason = "the panel read at each sensor pixel's centre"
        if has_black_matrix:
            self.reason += "; its black matrix dims it evenly, without moiré"

    def offsets(self, shot: ShotRecord) -> Tensor:
        return shot.panel_scale.new_zeros(len(shot), 2, 1)

    def read(
        self, picture: DisplayedPicture, x: Tensor, y: Tensor, shot: ShotRecord, channel: int
    ) -> Tensor:
        layout, alpha = shot.scene.panel.cell, shot.panel_scale[:, None, None]
        width, height = emitting_share(shot.panel)
        ends: tuple = (None, None)
        if shot.scene.is_dark_around:
            ends = (alpha * shot.size[1], alpha * shot.size[0])
        plane = torch.zeros_like(x, dtype=picture.light.dtype)
        for s in layout.of(channel):
            left, top, right, bottom = s.box()
            across, px = _raster(x, left, right, layout.raster, s.period[0], ends[0])
            down, py = _raster(y, top, bottom, layout.raster, s.period[1], ends[1])
            content = picture.look_up(px, py, channel)[:, 0]
            plane = plane + content * (across * down).to(plane.dtype)
        return plane * (width * height).to(plane.dtype)[:, None, None]


def _raster(
    at: Tensor, low: float, high: float, n: int, period: int, end: Tensor | None
) -> tuple[Tensor, Tensor]:
    """Return, along one axis, the light at a position that comes from a rectangle from `low` to
    `high`, through the two nearest of n raster subpixels per panel pixel, and where it comes from;
    positions in panel pixels. With an `end`, it is dark outside [0, end)."""
    at = at * n - 0.5
    first = at.floor().detach()
    to_second = at - first
    lights, pixels = [], []
    for column, near in ((first, 1 - to_second), (first + 1, to_second)):
        pixel = (column + 0.5).div(n).floor() + 0.5
        light = near
        if high - low < period:
            light = light * _lies_in(column, low * n, high * n, n * period)
        if end is not None:
            light = light * ((pixel >= 0) & (pixel < end))
        lights.append(light)
        pixels.append(pixel)
    total = lights[0] + lights[1]
    # both columns lie in one panel pixel, or the second in the next
    apart = pixels[1] - pixels[0]
    return total, pixels[0] + apart * lights[1] / total.clamp(min=1e-12)


def _lies_in(column: Tensor, low: float, high: float, around: int) -> Tensor:
    """Return the share of each raster column, given by its left edge, that lies between `low` and
    `high` in a cell of `around` columns."""
    column, share = column % around, torch.zeros_like(column)
    # a subpixel may reach into the cell before or behind
    for left in (column - around, column, column + around):
        share = share + ((left + 1).clamp(max=high) - left.clamp(min=low)).clamp(min=0)
    return share


class Supersample(Sampled):
    """The mean over n * n points of the aperture and the lens's spread. Converges to the integral:
    the reference."""

    def __init__(self, n: int) -> None:
        self.n = n
        self.name = f"supersample:{n}"
        self.reason = f"the mean over {n * n} points of the aperture and the lens spread"

    def offsets(self, shot: ShotRecord) -> Tensor:
        return optics_of(shot).offsets(self.n)

    def read(
        self, picture: DisplayedPicture, x: Tensor, y: Tensor, shot: ShotRecord, channel: int
    ) -> Tensor:
        width, height = (t[:, None, None] for t in emitting_share(shot.panel))
        total = torch.zeros_like(x, dtype=picture.light.dtype)
        for s in shot.scene.panel.cell.of(channel):
            lit = emits(s, x, y, width, height).to(total.dtype)
            total = total + self._content(picture, s, x, y, shot) * lit
        return total

    def _content(
        self, picture: DisplayedPicture, s: Subpixel, x: Tensor, y: Tensor, shot: ShotRecord
    ) -> Tensor:
        """Return the light of the nearest copies of a subpixel, at panel points."""
        alpha = shot.panel_scale[:, None, None]
        column, row = cell_of(s, x, y)
        px, py = column * s.period[0] + s.pixel[0], row * s.period[1] + s.pixel[1]
        light = picture.look_up(px, py, s.channel)[:, 0]
        if not shot.scene.is_dark_around:
            return light
        px, py = px / alpha, py / alpha
        return light * ((px >= 0) & (px < shot.size[1]) & (py >= 0) & (py < shot.size[0]))
