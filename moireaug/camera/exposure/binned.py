"""Binned readings: for each photo pixel, the mean of the sensor pixels of each colour in it. The
content of the picture there, times the share that the subpixels fill, by `alias_transfer`."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from moireaug.camera.exposure.alias_transfer import Wave, plane_waves, power_transfer, times
from moireaug.camera.exposure.axis_views import WHOLE_PIXEL, AxisView, axis_shares, panel_pixels
from moireaug.camera.exposure.bin_content import BinContent, content_of
from moireaug.camera.exposure.bin_geometry import (
    Bins,
    bins_at,
    bins_on_image,
    image_middle_bins,
    middle_bins,
)
from moireaug.camera.exposure.filters import filters_of
from moireaug.camera.exposure.footprint import Footprint, Optics, optics_of
from moireaug.camera.exposure.full import ClosedForm, in_bands
from moireaug.camera.exposure.screen import Screen
from moireaug.camera.panel import amplitudes_of, mean_light_of
from moireaug.scene.geometry.lattice import CFA
from moireaug.scene.shot import ShotRecord

# channels that the filters of red, green and blue pass: their own, or also its neighbours
SEPARATE = ((0,), (1,), (2,))
OVERLAPPING = ((0, 1), (0, 1, 2), (1, 2))


class Binned(ClosedForm):
    """A binned reading.

    Args:
        taps: see `ExposureMethod`.
        harmonics: (k, l) in cycles per cell of the layout, conjugates and (0, 0) left out; none for
            the panel's mean light alone.
        name: "spectral" or "mean", as in `Sensor.exposure`.
    """

    sums_harmonics = True

    def __init__(self, taps: int, harmonics: tuple[tuple[int, int], ...], *, name: str) -> None:
        super().__init__(taps)
        self.harmonics, self.name = harmonics, name
        self.reason = "the panel's mean light alone, so no moiré"
        if name == "spectral":
            self.reason = "harmonics by their modulation transfer and their aliases"

    def __call__(self, light: Tensor, shot: ShotRecord) -> Tensor:
        rows, cols = (pixels.positions(light.device) for pixels in shot.sampled_pixels())
        content = content_of(shot)
        screen = Screen(light, shot, self.taps, content)

        def reading_of(band: Tensor) -> Tensor:
            return self.read(screen, content, bins_at(band, cols, light.dtype, shot), shot)

        elements_per_row = len(cols) * max(self.taps**2, 16 * len(self.harmonics))
        planes = in_bands(reading_of, rows, elements_per_row, light, shot)
        (site,) = CFA[shot.scene.filter_cell]
        return planes[:, list(site.channels)]

    def read(self, screen: Screen, content: BinContent, bins: Bins, shot: ShotRecord) -> Tensor:
        """Return the readings of the pixels of each colour filter in bins: (B, 3, h, w)."""
        dtype = screen.light.dtype
        shares = mean_light_of(shot).to(dtype)[..., None, None]
        filters = filters_of(shot).to(dtype)[..., None, None]
        passed_channels = OVERLAPPING if "crosstalk" in shot.plan else SEPARATE
        modulation = self.modulation(bins, shot)
        picture = [self.picture_of(screen, content, channel, bins, shot) for channel in range(3)]
        planes = []
        for plane in range(3):
            total = torch.zeros_like(picture[0])
            for channel in passed_channels[plane]:
                share = shares[:, channel]
                if modulation:
                    share = share + modulation[plane][channel]
                total = total + filters[:, plane, channel] * (picture[channel] * share)
            planes.append(total)
        return torch.stack(planes, 1)

    def picture_of(
        self, screen: Screen, content: BinContent, channel: int, bins: Bins, shot: ShotRecord
    ) -> Tensor:
        """Return the picture in one channel as bins see it, (B, h, w)."""
        dtype, shares = bins.step.dtype, []
        for axis in (0, 1):
            at = bins.position[..., axis] - content.start[:, axis, None, None]
            at = at / content.ratio[:, None, None]
            at = at - content.shift[:, channel, axis, None, None]
            box, variance = content.footprint(axis, bins)
            added = content.interpolation_variance.to(dtype)[:, None, None]
            width = content.width[:, channel, axis, None, None].to(dtype)
            view = AxisView(WHOLE_PIXEL, axis, Footprint(box, variance + added), width)
            shares.append(axis_shares(view, at, shot, screen))
        return panel_pixels(screen, channel, *shares)

    def views(self, points: Tensor, shot: ShotRecord) -> tuple[list[AxisView], Tensor]:
        content, bins = content_of(shot), bins_on_image(points, shot)
        one = torch.ones_like(shot.panel_scale)[:, None, None]
        views = [AxisView(WHOLE_PIXEL, axis, content.footprint(axis, bins), one) for axis in (0, 1)]
        return views, content.scale[:, None, None]

    def modulation(self, bins: Bins, shot: ShotRecord) -> list[list[Tensor]]:
        """Return the sum of the harmonics of each channel's light, as the pixels of each colour
        filter read them: (B, h, w) by filter and channel. Empty if there are none."""
        if not self.harmonics:
            return []
        dtype, (px, py) = bins.step.dtype, shot.scene.panel.cell.period
        optics = Optics(*(t.to(dtype)[:, None, None] for t in optics_of(shot)))
        k, l = bins.position.new_tensor(self.harmonics).reshape(-1, 2, 1, 1, 1).unbind(1)
        x, y = bins.position.unbind(-1)
        cycles = k * (x / px) + l * (y / py)
        phase = 2 * math.pi * (cycles - cycles.detach().round()).to(dtype)
        per_x, per_y = (k / px).to(dtype), (l / py).to(dtype)
        step_x, step_y = bins.step.unbind(-2)
        u, v = (per_x * step_x[..., axis] + per_y * step_y[..., axis] for axis in (0, 1))
        passed = optics.transfer(u, v)
        carrier: Wave = passed * torch.cos(phase), passed * torch.sin(phase)
        bayer = shot.scene.is_binned_bayer
        plane_wave = plane_waves(u, v, bins.centre, bins.sides, bins.triangle, bayer=bayer)
        parts = amplitudes_of(shot, self.harmonics)
        real, imaginary = (part.to(dtype)[..., None, None] for part in parts)
        modulation = []
        for plane in range(3):
            cosine, sine = times(carrier, plane_wave[plane if bayer else 0])
            channels = []
            for channel in range(3):
                waves = real[channel] * cosine - imaginary[channel] * sine
                channels.append(waves.sum(0))
            modulation.append(channels)
        return modulation

    def pattern_variance(self, shot: ShotRecord) -> Tensor:
        if not self.harmonics:
            return super().pattern_variance(shot)
        lost, _ = self._power(middle_bins(shot), shot)
        return self._variance(lost, shot)

    def seen_variance(self, shot: ShotRecord) -> Tensor:
        """Return the variance of the moiré in the middle of the image, as a share of the squared
        reading, by colour filter: (B, 3)."""
        if not self.harmonics:
            return shot.panel_scale.new_zeros(len(shot), 3)
        _, seen = self._power(image_middle_bins(shot), shot)
        return self._variance(seen, shot)

    def _variance(self, power: Tensor, shot: ShotRecord) -> Tensor:
        """Return the variance of harmonics of which `_power` left a power (K, B, 3), as a share of
        the squared reading, (B, 3)."""
        filters = filters_of(shot)
        parts = amplitudes_of(shot, self.harmonics)
        real, imaginary = (torch.einsum("bpc,ckb->kbp", filters, part) for part in parts)
        total = (power * (real.square() + imaginary.square())).sum(0)
        mean = mean_light_of(shot)
        return total / (filters @ mean[..., None])[..., 0].square().clamp(min=1e-12)

    def _power(self, bins: Bins, shot: ShotRecord) -> tuple[Tensor, Tensor]:
        """Return the power that a bin (B, 1, 1) averages away of each harmonic that has an
        amplitude of 1 on the panel, and what it reads of it, by colour filter: (K, B, 3) each."""
        step, sides, triangle = bins.step[:, 0, 0], bins.sides[:, 0, 0], bins.triangle[:, 0, 0]
        k, l = step.new_tensor(self.harmonics)[:, :, None].unbind(1)
        px, py = shot.scene.panel.cell.period
        per_x, per_y = k / px, l / py
        u, v = (per_x * step[:, 0, axis] + per_y * step[:, 1, axis] for axis in (0, 1))
        power = optics_of(shot).transfer(u, v).square() / 2
        bayer = shot.scene.is_binned_bayer
        transfer = power_transfer(u, v, sides, triangle, bayer=bayer)
        read = torch.stack([transfer[plane if bayer else 0] for plane in range(3)], -1)
        return power[..., None] * (1 - read).clamp(min=0), power[..., None] * read
