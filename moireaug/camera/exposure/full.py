"""Exposures in closed form, and those of full readings: the content of the panel pixels that the
aperture covers, times the share that their subpixels fill. Spectral and box sum over subpixels and
differ in that share alone; mean takes the content of whole panel pixels, and their mean share."""

from __future__ import annotations

import functools
import math
from abc import abstractmethod
from collections.abc import Callable

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from moireaug.camera.exposure import extreme_readings
from moireaug.camera.exposure.axis_views import (
    AxisShares,
    AxisView,
    PanelPoints,
    axis_shares,
    axis_view,
    axis_views,
    covered_share,
    look_at_panel,
    panel_pixels,
    panel_steps,
    variance_beyond_taps,
)
from moireaug.camera.exposure.filters import filter_cell_seen, through_filters
from moireaug.camera.exposure.footprint import Optics, optics_of
from moireaug.camera.exposure.screen import Screen
from moireaug.camera.panel import coefficient, emitting_share, mean_light_of, own_orders
from moireaug.common.numeric import is_transformed
from moireaug.scene.exposure_method import ExposureMethod
from moireaug.scene.geometry import grids
from moireaug.scene.geometry.lattice import CFA, Site, pattern_period
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord

# elements of the largest tensor, by device: rows are read in bands that keep to it
MAX_TENSOR_ELEMENTS = {"cpu": 2**19, "cuda": 2**27}


class ClosedForm(ExposureMethod):
    """An exposure in closed form, differentiable in the image and in every field of the shot: the
    panel pixels around are summed, and the picture is blurred before by the rest of a view.

    Args:
        taps: see `ExposureMethod`.
    """

    differentiable_in_shot = True

    def __init__(self, taps: int) -> None:
        self.taps = taps

    @abstractmethod
    def views(self, points: Tensor, shot: ShotRecord) -> tuple[list[AxisView], Tensor]:
        """Return the views at image points (B, h, w, 2), and the panel pixels per image pixel of
        the panel that they see, (B, 1, 1)."""

    def lost_variance(self, points: Tensor, shot: ShotRecord) -> Tensor:
        views, alpha = self.views(points.expand(len(shot), -1, -1, -1), shot)
        return variance_beyond_taps(views, alpha, self.taps)

    def max_lost_variance(self, scene: SceneRecord) -> float:
        return extreme_readings.max_lost_variance(scene, self.taps)


def in_bands(
    read: Callable[[Tensor], Tensor],
    rows: Tensor,
    elements_per_row: int,
    light: Tensor,
    shot: ShotRecord,
) -> Tensor:
    """Return the readings (B, channels, h, w) of rows (h,), computed in bands to bound memory.

    Args:
        read: function of some rows that returns their readings.
        elements_per_row: elements of the largest tensor per row of an image.
        light: (B, 3, H, W) panel light of the images.
    """
    bands = 1
    if not torch.compiler.is_compiling():
        most = MAX_TENSOR_ELEMENTS.get(light.device.type, MAX_TENSOR_ELEMENTS["cuda"])
        bands = 1 + len(light) * len(rows) * elements_per_row // most
    recompute = shot.requires_grad and torch.is_grad_enabled() and not is_transformed()
    if recompute:  # what the shot keeps must be there before a band is computed, and again
        _ = shot.frame, shot.inverse_matrix()
    readings = []
    for band in rows.chunk(bands):
        if recompute:  # a pose's gradient would keep kilobytes per reading
            reading = checkpoint(read, band, use_reentrant=False, preserve_rng_state=False)
            readings.append(reading)
        else:
            readings.append(read(band))
    return torch.cat(readings, 2)


class FullReading(ClosedForm):
    """A value for each sensor pixel, in closed form.

    Args:
        taps: see `ExposureMethod`.
        in_float64: compute shares in float64, which an aperture much smaller than the panel's
            cell needs.
    """

    def __init__(self, taps: int, *, in_float64: bool) -> None:
        super().__init__(taps)
        self.in_float64 = in_float64

    def __call__(self, light: Tensor, shot: ShotRecord) -> Tensor:
        cfa, screen = filter_cell_seen(shot), Screen(light, shot, self.taps)
        rows, cols = (pixels.positions(light.device) for pixels in shot.sampled_pixels())
        period, planes = pattern_period(cfa), []
        for site in CFA[cfa]:
            across = cols[site.column :: period]
            read = functools.partial(self._read_band, site, across, screen, shot)
            elements_per_row = len(across) * max(self.taps**2, len(self.harmonics))
            down = rows[site.row :: period]
            planes.append(in_bands(read, down, elements_per_row, light, shot))
        return through_filters(torch.cat(planes, 1), shot)

    def _read_band(
        self, site: Site, cols: Tensor, screen: Screen, shot: ShotRecord, rows: Tensor
    ) -> Tensor:
        """Return the colours that one site of the filter cell sees at photo coordinates
        rows x cols: (B, channels, h, w)."""
        dtype = torch.float64 if self.in_float64 else screen.light.dtype
        points = look_at_panel(rows, cols, dtype, shot)
        colours = [self.read(screen, channel, points, shot) for channel in site.channels]
        return torch.stack(colours, 1)

    @abstractmethod
    def read(self, screen: Screen, channel: int, points: PanelPoints, shot: ShotRecord) -> Tensor:
        """Return the sensor pixels' readings of one channel: (B, h, w)."""

    def views(self, points: Tensor, shot: ShotRecord) -> tuple[list[AxisView], Tensor]:
        ideal = grids.image_to_photo(points, shot.matrix(), shot.size, None)
        # a lens hardly changes how much a view spreads
        step = panel_steps(ideal, None, shot)
        return axis_views(shot.scene, step, optics_of(shot)), shot.panel_scale[:, None, None]


class BySubpixel(FullReading):
    """An exposure that sums over a channel's subpixels: the panel pixels around, times the share of
    the view that the subpixels fill."""

    def read(self, screen: Screen, channel: int, points: PanelPoints, shot: ShotRecord) -> Tensor:
        lit, optics = emitting_share(shot.panel), optics_of(shot)
        total = torch.zeros_like(points.position[..., 0], dtype=screen.light.dtype)
        for subpixel in shot.scene.panel.cell.of(channel):
            views = [axis_view(subpixel, axis, points.step, lit, optics) for axis in (0, 1)]
            x, y = (axis_shares(v, points.position[..., v.axis], shot, screen) for v in views)
            through = self.transmission(x, y, points.step, shot)
            total = total + panel_pixels(screen, channel, x, y) * through
        return total

    @abstractmethod
    def transmission(self, x: AxisShares, y: AxisShares, step: Tensor, shot: ShotRecord) -> Tensor:
        """Return the share of the view that the subpixels fill, (B, h, w); step: see
        `PanelPoints`."""


class Spectral(BySubpixel):
    """The panel's harmonics, each weighted by its modulation transfer: exact in the aperture, the
    lens and the view's local scale.

    Args:
        harmonics: (k, l) in cycles per cell of the layout, conjugates and (0, 0) left out.
    """

    name = "spectral"
    reason = "harmonics by their modulation transfer"
    sums_harmonics = True

    def __init__(
        self, taps: int, harmonics: tuple[tuple[int, int], ...], *, in_float64: bool
    ) -> None:
        super().__init__(taps, in_float64=in_float64)
        self.harmonics = harmonics

    def transmission(self, x: AxisShares, y: AxisShares, step: Tensor, shot: ShotRecord) -> Tensor:
        subpixel, layout, dtype = x.view.subpixel, shot.scene.panel.cell, x.share.dtype
        optics = Optics(*(t.to(dtype)[:, None, None] for t in optics_of(shot)))
        width, height = (t.to(dtype)[:, None, None] for t in emitting_share(shot.panel))
        orders = []
        for pair in self.harmonics:
            own_k, own_l, has = own_orders(subpixel, layout, *pair)
            if has:
                orders.append((own_k, own_l))
        k, l = x.cells.new_tensor(orders).reshape(-1, 2, 1, 1, 1).unbind(1)
        cycles = k * x.cells + l * y.cells  # (harmonics, B, h, w)
        # drop whole cycles before the cast, so that the phase stays precise far from the origin
        phase = 2 * math.pi * (cycles - cycles.detach().round()).to(dtype)
        k, l = k.to(dtype), l.to(dtype)
        across, down = (step[..., axis, :].to(dtype) for axis in (0, 1))
        across, down = across / subpixel.period[0], down / subpixel.period[1]
        fu = k * across[..., 0] + l * down[..., 0]
        fv = k * across[..., 1] + l * down[..., 1]
        amplitude = 2 * coefficient(subpixel, k, l, width, height) * optics.transfer(fu, fv)
        mean = coefficient(subpixel, 0, 0, width, height)
        return mean + (amplitude * torch.cos(phase)).sum(0)


class Box(BySubpixel):
    """The overlap of aperture and subpixels along x and along y: exact for an upright view. For
    screens magnified so much that a series would need too many harmonics."""

    name = "box"
    reason = "the overlap of subpixel and aperture"

    def transmission(self, x: AxisShares, y: AxisShares, step: Tensor, shot: ShotRecord) -> Tensor:
        return covered_share(x) * covered_share(y)


class Mean(FullReading):
    """The panel's mean light alone, so no moiré: the control of every experiment."""

    name = "mean"
    reason = "the panel's mean light alone, so no moiré"

    def read(self, screen: Screen, channel: int, points: PanelPoints, shot: ShotRecord) -> Tensor:
        shares = mean_light_of(shot).to(screen.light.dtype)
        views = axis_views(shot.scene, points.step, optics_of(shot))
        x, y = (axis_shares(v, points.position[..., v.axis], shot, screen) for v in views)
        return panel_pixels(screen, channel, x, y) * shares[:, channel, None, None]
