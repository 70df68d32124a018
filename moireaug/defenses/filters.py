"""Deterministic defences by short formulae: JPEG, bit depth, median and brightness."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from moireaug.camera.effects.jpeg import jpeg
from moireaug.common.argument_checks import check_real, check_whole
from moireaug.common.image_checks import check_images
from moireaug.common.numeric import clip, mirrored_indices, widen_half
from moireaug.defenses.base import Defence, straight_through

MIN_MEAN = 1 / 255  # to which `Gain` raises a lower mean, so that black stays black


@dataclass(frozen=True)
class JPEG(Defence):
    """Encode and decode (Dziugaite, Ghahramani and Roy 2016; Das et al. 2017): libjpeg as PIL runs
    it, 4:2:0.

    Args:
        quality: 1 to 100. The paper takes 20, 40, 60 and 80.

    Backward: kornia's differentiable JPEG, see `moireaug.camera.effects.jpeg.jpeg`.

    Raises:
        TypeError, ValueError: another quality.
    """

    quality: int = 60

    def __post_init__(self) -> None:
        check_whole("JPEG.quality", self.quality, 1, 100)

    def apply(self, images: Tensor) -> Tensor:
        return jpeg(images, images.new_full((len(images),), self.quality))


@dataclass(frozen=True)
class BitDepth(Defence):
    """Feature squeezing's fewer colours (Xu, Evans and Qi 2018): rint(x (2^b - 1)) / (2^b - 1),
    halves to even.

    Args:
        bits: of each channel, 1 to 8. The paper takes 4 and 5.

    Backward: the identity.

    Raises:
        TypeError, ValueError: another number of bits.
    """

    bits: int = 4

    def __post_init__(self) -> None:
        check_whole("BitDepth.bits", self.bits, 1, 8)

    def apply(self, images: Tensor) -> Tensor:
        top = 2**self.bits - 1
        return straight_through(images, (images * top).round() / top)


@dataclass(frozen=True)
class Median(Defence):
    """Feature squeezing's median filter (Xu, Evans and Qi 2018), of each channel by itself.

    The values of `scipy.ndimage.median_filter(channel, size, mode="reflect")`: an even window lies
    one pixel further up and left than down and right, takes the upper of its two middle values, and
    the border is mirrored.

    Args:
        size: the window's side in pixels, 2 to 7. The paper takes 2 and 3.

    Backward: exact; the gradient goes to the pixel that was taken, among equals to the first in
    reading order.

    Raises:
        TypeError, ValueError: another size.
    """

    size: int = 2

    def __post_init__(self) -> None:
        check_whole("Median.size", self.size, 2, 7)

    def apply(self, images: Tensor) -> Tensor:
        return _Median.apply(images, self.size)


class _Median(torch.autograd.Function):
    # image by image: the many passes over one image stay in the cache
    @staticmethod
    def forward(ctx, images, size):
        out = torch.empty_like(images)
        rows, cols = _window_indices(images, size)
        for row, image in zip(out, images, strict=True):
            row.copy_(_median(image[:, rows][:, :, cols], size))
        ctx.save_for_backward(images, out)
        ctx.size = size
        ctx.set_materialize_grads(False)  # no gradient is not one of zeros
        return out

    @staticmethod
    def backward(ctx, gradient):
        if gradient is None:
            return None, None
        images, out = ctx.saved_tensors
        size, image_gradients = ctx.size, torch.empty_like(images)
        h, w = images.shape[-2:]
        rows, cols = _window_indices(images, size)
        for row, image, median, g in zip(image_gradients, images, out, gradient, strict=True):
            extended = image[:, rows][:, :, cols]
            extended_gradient, remaining = torch.zeros_like(extended), g.clone()
            for i in range(size):
                for j in range(size):
                    window = (slice(None), slice(i, i + h), slice(j, j + w))
                    share = torch.where(extended[window] == median, remaining, 0)
                    extended_gradient[window] += share
                    remaining -= share  # a gradient goes to one pixel only
            folded = image.new_zeros(3, h, len(cols)).index_add_(1, rows, extended_gradient)
            row.copy_(image.new_zeros(3, h, w).index_add_(2, cols, folded))
        return image_gradients, None


def _window_indices(images: Tensor, size: int) -> list[Tensor]:
    """Return the rows and columns of images that windows see, mirrored past the border."""
    before, after = size // 2, size - 1 - size // 2
    return [mirrored_indices(n, before, after, images.device) for n in images.shape[-2:]]


def _median(x: Tensor, size: int) -> Tensor:
    """Return the upper median of every window: (3, H + size - 1, W + size - 1) to (3, H, W)."""
    if size == 2:  # the columns' pairs are sorted once for both windows that share them
        low, high = torch.minimum(x[:, :-1], x[:, 1:]), torch.maximum(x[:, :-1], x[:, 1:])
        return torch.maximum(
            torch.minimum(high[..., :-1], high[..., 1:]), torch.maximum(low[..., :-1], low[..., 1:])
        )  # the second largest of four
    if size == 3:
        a, b, c = x[:, :-2], x[:, 1:-1], x[:, 2:]
        low, high = torch.minimum(a, b), torch.maximum(a, b)
        mid = torch.maximum(low, torch.minimum(high, c))
        low, high = torch.minimum(low, c), torch.maximum(high, c)
        # the median of nine: of its columns' greatest low, middle mid and least high
        low = torch.maximum(torch.maximum(low[..., :-2], low[..., 1:-1]), low[..., 2:])
        high = torch.minimum(torch.minimum(high[..., :-2], high[..., 1:-1]), high[..., 2:])
        return _middle(low, _middle(mid[..., :-2], mid[..., 1:-1], mid[..., 2:]), high)
    windows = x.unfold(1, size, 1).unfold(2, size, 1).flatten(3)
    return windows.kthvalue(size * size // 2 + 1, dim=-1).values


def _middle(a: Tensor, b: Tensor, c: Tensor) -> Tensor:
    return torch.maximum(torch.minimum(a, b), torch.minimum(torch.maximum(a, b), c))


@dataclass(frozen=True)
class Gain(Defence):
    """Scale the brightness to a fixed mean: the deployable form of the paper's mean normalisation,
    `restore_mean`.

    Every image is multiplied by one factor so that its mean over pixels and channels becomes
    `mean`, then clipped, which leaves the mean lower where highlights clip. No factor is above mean
    x 255: black stays black.

    Args:
        mean: above 0, at most 1, in units of sRGB codes; by default near that of natural images.

    Backward: exact but for the clipping, whose gradient is the identity's.

    Raises:
        TypeError, ValueError: another mean.
    """

    mean: float = 0.45

    def __post_init__(self) -> None:
        check_real("Gain.mean", self.mean, 0, 1)

    def apply(self, images: Tensor) -> Tensor:
        mean = images.mean((1, 2, 3), keepdim=True).clamp(min=MIN_MEAN)
        scaled = images * (self.mean / mean)
        return straight_through(scaled, scaled.clamp(0, 1))


def restore_mean(images: Tensor, clean: Tensor) -> Tensor:
    """Compute the paper's mean normalisation: x - (mean(x) - mean(clean)), clipped to [0, 1]. It
    needs the clean image, which no deployed system has: an upper bound for `Gain`, not a defence.

    Args:
        images: (B, 3, H, W) float in [0, 1], attacked or photographed. Not modified.
        clean: the images as they were, of the same shape. Means are over all pixels and channels of
            each image.

    Returns:
        (B, 3, H, W) in [0, 1], of the images' dtype. Differentiable in both; pixels on the bounds
        keep their gradient.

    Raises:
        TypeError, ValueError: images that are not a float batch of three channels in [0, 1], or
            batches of different shapes.
    """
    images, clean = check_images(images), check_images(clean)
    if images.shape != clean.shape:
        raise ValueError(
            f"clean must have the images' shape {tuple(images.shape)}; got {tuple(clean.shape)}. "
            "Give each image its own."
        )
    x = widen_half(images)
    shift = x.mean((1, 2, 3), keepdim=True) - clean.to(x).mean((1, 2, 3), keepdim=True)
    return clip(x - shift).to(images.dtype)
