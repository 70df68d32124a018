"""What a camera does to detail before it saves a photo: it smooths colour to reduce noise, and
sharpens brightness."""

from __future__ import annotations

import math

from kornia.filters import filter2d_separable, get_gaussian_kernel1d
from torch import Tensor

from moireaug.effects.base import Effect, Verdict, called, judged, left_out, off, show
from moireaug.numeric import clip, per_image, repeat_edges
from moireaug.scene.fields import Range, bounds
from moireaug.scene.record import SceneRecord

REACH = 3.0  # standard deviations that a kernel holds
SMALLEST = 1e-3  # least standard deviation: a Gaussian of 0 has no kernel


class ChromaBlur(Effect):
    """Smooths colour, but not brightness."""

    name = "chroma_blur"

    def verdict(self, scene: SceneRecord) -> Verdict:
        blur = scene.develop.chroma_blur
        if bounds(blur)[1] == 0:
            return left_out("colour keeps its detail")
        return called(f"colour smoothed by {show(blur)} sensor pixels")

    def __call__(self, photo: Tensor, shot) -> Tensor:
        size = kernel_size(shot.scene.develop.chroma_blur)
        return chroma_blur(photo, shot.develop.chroma_blur, size)


class Sharpen(Effect):
    """An unsharp mask on brightness."""

    name = "sharpen"

    def verdict(self, scene: SceneRecord) -> Verdict:
        develop = scene.develop
        why = (
            f"unsharp mask of {show(develop.sharpen)}, {show(develop.sharpen_radius)} sensor pixels"
        )
        return judged(off(develop.sharpen, 0), scene, why, "not asked for")

    def __call__(self, photo: Tensor, shot) -> Tensor:
        size = kernel_size(shot.scene.develop.sharpen_radius)
        develop = shot.develop
        return sharpen(photo, develop.sharpen, develop.sharpen_radius, size)


class ClipDetail(Effect):
    """Clips a smoothed or sharpened photo to [0, 1]."""

    name = "clip_detail"
    shown = False

    def verdict(self, scene: SceneRecord) -> Verdict:
        if ChromaBlur().verdict(scene).called or Sharpen().verdict(scene).called:
            return called("overshoots end at 0 and 1")
        return left_out("nothing overshoots")

    def __call__(self, photo: Tensor, shot) -> Tensor:
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
    sigmas = sigma.clamp(min=SMALLEST).to(planes.dtype)[:, None]
    kernel, half = get_gaussian_kernel1d(size, sigmas), size // 2
    wide = repeat_edges(planes, half, half, half, half)
    return filter2d_separable(wide, kernel, kernel, padding="valid")


def kernel_size(sigma: Range) -> int:
    """Return the odd number of pixels along a kernel that holds a range's widest Gaussian."""
    return 2 * math.ceil(REACH * bounds(sigma)[1]) + 1
