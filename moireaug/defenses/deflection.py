"""Pixel deflection: a few pixels take a neighbour's colour, and wavelet denoising smooths the
result."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from moireaug.common.argument_checks import check_real, check_whole
from moireaug.defenses.base import Defence, straight_through


@dataclass(frozen=True)
class PixelDeflection(Defence):
    """Pixel deflection with wavelet denoising (Prakash et al. 2018), by default with the paper's
    numbers, without the map that steers it (R-CAM).

    As the paper's algorithm 1: one after the other, `deflections` pixels drawn uniformly each take
    the colour of a pixel drawn uniformly from those within `window` pixels along each axis. All
    three channels move at once and count once (the authors' code counts channels). Then soft
    thresholding by BayesShrink in YCbCr: scikit-image's `denoise_wavelet`, db1.

    Args:
        deflections: number of deflected pixels of each image, at least 0.
        window: largest distance that a colour comes from along each axis, in pixels, at least 1.
        sigma: standard deviation of the noise, in units of [0, 1] images, above 0.

    Backward: a deflected pixel's gradient goes to where its colour came from; the denoising is the
    identity.

    Raises:
        TypeError, ValueError: a number out of its bounds.
    """

    deflections: int = 200
    window: int = 10
    sigma: float = 0.04

    randomised = True

    def __post_init__(self) -> None:
        check_whole("PixelDeflection.deflections", self.deflections, 0)
        check_whole("PixelDeflection.window", self.window, 1)
        check_real("PixelDeflection.sigma", self.sigma, 0)

    def apply(self, images: Tensor) -> Tensor:
        b, _, h, w = images.shape
        source = torch.from_numpy(self.sources(b, h, w)).to(images.device)
        deflected = images.flatten(2).gather(2, source[:, None].expand(-1, 3, -1)).view_as(images)
        return straight_through(deflected, denoise(deflected.detach(), self.sigma))

    def sources(self, b: int, h: int, w: int) -> np.ndarray:
        """Return the flat index of the pixel that each pixel's colour comes from, (b, h w)."""
        # an image's numbers are drawn together: the same whether or not the batch comes in parts
        drawn = torch.rand(b, 4, self.deflections, dtype=torch.float64, device="cpu")
        u = drawn.permute(1, 2, 0).numpy()
        rows, cols = np.floor(u[0] * h).astype(int), np.floor(u[1] * w).astype(int)
        origins = self._nearby_positions(rows, h, u[2]) * w + self._nearby_positions(cols, w, u[3])
        source, image = np.tile(np.arange(h * w), (b, 1)), np.arange(b)
        targets = rows * w + cols
        for target, origin in zip(targets, origins, strict=True):  # in turn: a colour can travel on
            source[image, target] = source[image, origin]
        return source

    def _nearby_positions(self, positions: np.ndarray, size: int, u: np.ndarray) -> np.ndarray:
        """Return whole positions within `window` of the given ones, uniform in [0, size)."""
        low = np.maximum(positions - self.window, 0)
        high = np.minimum(positions + self.window, size - 1)
        return low + np.floor(u * (high - low + 1)).astype(int)


def denoise(images: Tensor, sigma: float) -> Tensor:
    """Denoise images (B, 3, H, W) float32 or float64 in [0, 1] by soft wavelet thresholding in
    YCbCr (BayesShrink; Chang, Yu and Vetterli 2000), one by one; sigma in their units."""
    from skimage.restoration import denoise_wavelet  # imported here, as it takes a while

    out = torch.empty(images.shape, dtype=images.dtype, device="cpu")
    for row, image in zip(out, images.permute(0, 2, 3, 1).cpu().numpy(), strict=True):
        h, w, _ = image.shape
        # one level of the wavelet takes two pixels
        image = np.pad(image, ((0, int(h == 1)), (0, int(w == 1)), (0, 0)), "edge")
        # by BayesShrink, soft
        clean = denoise_wavelet(image, sigma=sigma, convert2ycbcr=True, channel_axis=-1)
        row.copy_(torch.from_numpy(clean[:h, :w]).permute(2, 0, 1))
    return out.clamp(0, 1).to(images.device)
