"""Panel light integrated over the aperture: the content of the panel pixels it covers, times the
share that their subpixels fill. Spectral, box and mean differ only in the second factor."""

from __future__ import annotations

import functools
import math
from abc import abstractmethod

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from moireaug.exposure.base import ExposureMethod
from moireaug.exposure.filters import colours_seen, through_filters
from moireaug.exposure.optics import Optics, optics_of
from moireaug.exposure.screen import Screen
from moireaug.exposure.sight import (
    WHOLE_PIXEL,
    AlongAxis,
    Sight,
    along_axis,
    covered,
    look_at_panel,
    panel_pixels,
)
from moireaug.geometry.sensor import CFA, Site, cell
from moireaug.numeric import is_transformed
from moireaug.panel.fourier import coefficient, emitting_share, mean_light, own_orders
from moireaug.scene.layout import as_layout
from moireaug.scene.subpixel import Subpixel
from moireaug.shot import ShotRecord

# numbers of the largest tensor, which bands of rows bound
MAX_TENSOR_NUMBERS = {"cpu": 2**19, "cuda": 2**27}
MAX_BANDS = 64  # each allocates a gradient of the whole panel


class SmoothExposure(ExposureMethod):
    """An exposure in closed form, differentiable in the image and in every field of the shot.

    Args:
        taps: see `ExposureMethod`.
        fine: compute shares in float64, which an aperture much smaller than the panel's cell
            needs.
    """

    differentiable_in_shot = True

    def __init__(self, taps: int, *, fine: bool = True) -> None:
        self.taps, self.fine = taps, fine

    def __call__(self, light: Tensor, shot: ShotRecord) -> Tensor:
        cfa, screen = colours_seen(shot), Screen(light, shot, self.taps)
        accuracy = torch.float64 if self.fine else light.dtype
        rows, cols = (pixels.positions(light.device) for pixels in shot.sampled_pixels())
        inverse = torch.linalg.inv(shot.matrix())
        read_site = self.read_site
        if shot.requires_grad and torch.is_grad_enabled() and not is_transformed():
            # a pose's gradient would keep some kilobytes per reading: recompute them instead
            read_site = functools.partial(
                checkpoint, self.read_site, use_reentrant=False, preserve_rng_state=False
            )
        planes = []
        for site in CFA[cfa]:
            down, across = rows[site.row :: cell(cfa)], cols[site.column :: cell(cfa)]
            readings = []
            for band in down.chunk(self.bands(light, len(down) * len(across))):
                readings.append(read_site(site, screen, inverse, band, across, accuracy, shot))
            planes.append(torch.cat(readings, 2))
        return through_filters(torch.cat(planes, 1), shot)

    def read_site(
        self,
        site: Site,
        screen: Screen,
        inverse: Tensor,
        rows: Tensor,
        cols: Tensor,
        accuracy: torch.dtype,
        shot: ShotRecord,
    ) -> Tensor:
        """Return the colours that one site of the filter cell sees at photo coordinates
        rows x cols: (B, channels, h, w).

        `inverse` is the homography (B, 3, 3) from ideal photo to image coordinates.
        """
        sight = look_at_panel(rows, cols, inverse, accuracy, shot)
        colours = [self.read(screen, channel, sight, shot) for channel in site.channels]
        return torch.stack(colours, 1)

    @abstractmethod
    def read(self, screen: Screen, channel: int, sight: Sight, shot: ShotRecord) -> Tensor:
        """Return what sensor pixels read of one channel: (B, h, w)."""

    def bands(self, light: Tensor, readings: int) -> int:
        """Return the number of bands of rows into which a site's readings of each image are cut, to
        bound memory."""
        return bands_of(light, readings, max(self.taps**2, len(self.harmonics)))


def bands_of(light: Tensor, readings: int, numbers: int) -> int:
    """Return the number of bands of rows into which the readings of images are cut, to bound
    memory.

    Args:
        light: (B, 3, H, W) panel light of the images.
        readings: readings of each image.
        numbers: numbers of the largest tensor that belong to one reading.
    """
    if torch.compiler.is_compiling():
        return 1
    most = MAX_TENSOR_NUMBERS.get(light.device.type, MAX_TENSOR_NUMBERS["cuda"])
    return min(MAX_BANDS, 1 + len(light) * readings * numbers // most)


class BySubpixel(SmoothExposure):
    """An exposure that sums over a channel's subpixels: the panel pixels around, times the share of
    the view that the subpixels fill."""

    def read(self, screen: Screen, channel: int, sight: Sight, shot: ShotRecord) -> Tensor:
        layout = as_layout(shot.scene.panel.layout)
        total = torch.zeros_like(sight.position[..., 0], dtype=screen.light.dtype)
        for subpixel in layout.of(channel):
            x, y = (along_axis(axis, subpixel, sight, shot, screen) for axis in (0, 1))
            through = self.transmission(x, y, subpixel, sight, shot)
            total = total + panel_pixels(screen, channel, x, y, subpixel) * through
        return total

    @abstractmethod
    def transmission(
        self, x: AlongAxis, y: AlongAxis, subpixel: Subpixel, sight: Sight, shot: ShotRecord
    ) -> Tensor:
        """Return the share of the view that the subpixels fill, (B, h, w)."""


class Spectral(BySubpixel):
    """The panel's harmonics, each weighted by its modulation transfer: exact in the aperture, the
    lens and the view's local scale.

    Args:
        harmonics: (k, l) in cycles per cell of the layout, conjugates and (0, 0) left out.
    """

    name = "spectral"
    reason = "harmonics by their modulation transfer"

    def __init__(self, taps: int, harmonics: tuple[tuple[int, int], ...], *, fine: bool) -> None:
        super().__init__(taps, fine=fine)
        self.harmonics = harmonics

    def transmission(
        self, x: AlongAxis, y: AlongAxis, subpixel: Subpixel, sight: Sight, shot: ShotRecord
    ) -> Tensor:
        dtype, layout = x.share.dtype, as_layout(shot.scene.panel.layout)
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
        across, down = (sight.step[..., axis, :].to(dtype) for axis in (0, 1))
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

    def transmission(
        self, x: AlongAxis, y: AlongAxis, subpixel: Subpixel, sight: Sight, shot: ShotRecord
    ) -> Tensor:
        return covered(x) * covered(y)


class Mean(SmoothExposure):
    """The panel's mean light alone, so no moiré: the control of every experiment."""

    name = "mean"
    reason = "the panel's mean light alone, so no moiré"

    def read(self, screen: Screen, channel: int, sight: Sight, shot: ShotRecord) -> Tensor:
        layout = as_layout(shot.scene.panel.layout)
        share = mean_light(layout, channel, *emitting_share(shot.panel)).to(screen.light.dtype)
        x, y = (along_axis(axis, WHOLE_PIXEL, sight, shot, screen) for axis in (0, 1))
        return panel_pixels(screen, channel, x, y, WHOLE_PIXEL) * share[:, None, None]
