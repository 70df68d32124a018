"""The detail of a photo before a camera saves it: colour smoothed to reduce noise, and brightness
sharpened."""

from __future__ import annotations

import functools
import math

import torch
from torch import Tensor

from moireaug.camera.effects.base import Effect, Verdict, called, format_range, left_out, verdict_of
from moireaug.camera.exposure.extremes import least_bin_scale
from moireaug.common.numeric import clip, per_image, repeat_edges
from moireaug.scene.fields import bounds, deviation
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord
from moireaug.scene.sized import panel_scales

KERNEL_SIGMAS = 3.0  # standard deviations that a kernel holds
MIN_SAMPLED_VARIANCE = 0.5  # squared pixels: a narrower Gaussian misses the next pixel
MIN_SIGMA = 1e-3  # least standard deviation: a Gaussian of 0 has no kernel


class ChromaBlur(Effect):
    """Smooths colour, but not brightness."""

    name = "chroma_blur"
    needs_every_pixel = True

    def verdict(self, scene: SceneRecord) -> Verdict:
        blur = scene.develop.chroma_blur
        if bounds(blur)[1] == 0:
            return left_out("colour keeps its detail")
        return called(f"colour smoothed by {format_range(blur)} sensor pixels")

    def __call__(self, photo: Tensor, shot: ShotRecord) -> Tensor:
        size = kernel_size(max_photo_sigma(shot.scene, "chroma_blur", shot.whole_size))
        return chroma_blur(photo, in_photo(shot, shot.develop.chroma_blur), size)


class Sharpen(Effect):
    """An unsharp mask on brightness."""

    name = "sharpen"
    needs_every_pixel = True

    def verdict(self, scene: SceneRecord) -> Verdict:
        develop = scene.develop
        amount, radius = format_range(develop.sharpen), format_range(develop.sharpen_radius)
        why = f"unsharp mask of {amount}, {radius} sensor pixels"
        return verdict_of(deviation(develop.sharpen, 0), scene, why, "not asked for")

    def __call__(self, photo: Tensor, shot: ShotRecord) -> Tensor:
        size = kernel_size(max_photo_sigma(shot.scene, "sharpen_radius", shot.whole_size))
        develop = shot.develop
        return sharpen(photo, develop.sharpen, in_photo(shot, develop.sharpen_radius), size)


class ClipDetail(Effect):
    """Clips a smoothed or sharpened photo to [0, 1]."""

    name = "clip_detail"
    is_listed = False

    def verdict(self, scene: SceneRecord) -> Verdict:
        if ChromaBlur().verdict(scene).called or Sharpen().verdict(scene).called:
            return called("overshoots end at 0 and 1")
        return left_out("nothing overshoots")

    def __call__(self, photo: Tensor, shot: ShotRecord) -> Tensor:
        return clip(photo)


def chroma_blur(photo: Tensor, sigma: Tensor, size: int) -> Tensor:
    """Return photos (B, 3, H, W) with the difference of each colour from brightness smoothed by
    Gaussians of sigma (B,) pixels, in kernels of `size` pixels."""
    grey = brightness(photo)
    colour = photo - grey
    return grey + gaussian(colour, sigma, size)


def sharpen(photo: Tensor, amount: Tensor, sigma: Tensor, size: int) -> Tensor:
    """Return photos (B, 3, H, W) sharpened by an amount (B,) >= -1: the factor on the difference
    of brightness from its Gaussian mean, which is added. Negative amounts smooth; -1 leaves the
    mean. Arguments as in `chroma_blur`."""
    grey = brightness(photo)
    return photo + per_image(amount, photo) * (grey - gaussian(grey, sigma, size))


def brightness(photo: Tensor) -> Tensor:
    """Return the mean of the colours, (B, 1, H, W)."""
    return photo.mean(1, keepdim=True)


def gaussian(planes: Tensor, sigma: Tensor, size: int) -> Tensor:
    """Return planes (B, C, H, W) blurred by Gaussians of sigma (B,) pixels; edge pixels are
    repeated past the border."""
    # on first use, as in `denoise.bilateral`
    from kornia.filters import filter2d_separable, get_gaussian_kernel1d

    sigmas = sigma.clamp(min=MIN_SIGMA).to(planes.dtype)[:, None]
    kernel, half = get_gaussian_kernel1d(size, sigmas), size // 2
    wide = repeat_edges(planes, half, half, half, half)
    return filter2d_separable(wide, kernel, kernel, padding="valid")


def in_photo(shot: ShotRecord, sigma: Tensor) -> Tensor:
    """Return standard deviations in sensor pixels (B,) as those of kernels in the pixels that are
    developed: in photo pixels of a binned reading, and at most the photo's longer side."""
    if not shot.scene.is_binned:
        return sigma
    return kernel_sigma((sigma / shot.bin_scale).clamp(max=max(shot.whole_size)))


def kernel_sigma(sigma: Tensor) -> Tensor:
    """Return the standard deviation (B,) whose Gaussian, taken at whole pixels alone, has the
    variance of a Gaussian of sigma (B,) pixels. They differ below 0.7: a narrow Gaussian misses
    the next pixel."""
    variance = sigma.square().clamp(min=MIN_SIGMA**2)
    small = variance.clamp(max=MIN_SAMPLED_VARIANCE)
    w = small / (2 * (1 - small))  # of the next pixel, by Newton steps from that of three pixels
    for _ in range(3):
        twice, fourth, cube = 2 * w, w**4, w**3
        total, moment = 1 + twice + 2 * fourth, twice + 8 * fourth
        slope = ((2 + 32 * cube) * total - moment * (2 + 8 * cube)) / total.square()
        w = w - (moment / total - small) / slope
    return torch.where(variance > MIN_SAMPLED_VARIANCE, sigma, (-0.5 / w.log()).sqrt())


@functools.lru_cache(maxsize=256)
def max_photo_sigma(scene: SceneRecord, name: str, size: tuple[int, int]) -> float:
    """Return the greatest standard deviation of a field of `Develop`, which is in sensor pixels, in
    the pixels that are developed."""
    sigma = bounds(getattr(scene.develop, name))[1]
    if not scene.is_binned:
        return sigma
    alpha, _ = panel_scales(scene, size)
    return min(sigma / least_bin_scale(scene, alpha), float(max(size)))


def kernel_size(sigma: float) -> int:
    """Return the odd number of pixels along a kernel that holds a Gaussian of sigma pixels."""
    return 2 * math.ceil(KERNEL_SIGMAS * sigma) + 1
