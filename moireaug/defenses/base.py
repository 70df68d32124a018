"""The base of every defence: checked images in and out, and the straight-through gradient."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable

import torch
from torch import Tensor, nn

from moireaug.common.image_checks import check_images
from moireaug.common.numeric import widen_half


class Defence(ABC):
    """Base class of defences, functions from images to images; a subclass is a frozen dataclass
    with `apply`.

    Forward is the real operation. Backward is its own gradient where that is useful, otherwise the
    approximation that it documents (BPDA; Athalye, Carlini and Wagner 2018). Attribute:
    `randomised`, whether it draws random numbers, from torch's global CPU generator.
    """

    randomised = False

    @property
    def networks(self) -> tuple[nn.Module, ...]:
        """The modules that it computes with."""
        return ()

    def __call__(self, images: Tensor) -> Tensor:
        """Defend a batch.

        Args:
            images: (B, 3, H, W) float in [0, 1], sRGB codes. Not modified. Half precision is
                computed in float32.

        Returns:
            (B, 3, H, W) in [0, 1], of the images' dtype and device. Differentiable in images, once.

        Raises:
            TypeError, ValueError: images that are not a float batch of three channels in [0, 1], or
                hold NaN.
        """
        images = check_images(images)
        if not len(images):
            return images.clone()
        with torch.autocast(images.device.type, enabled=False):
            return self.apply(widen_half(images)).to(images.dtype)

    @abstractmethod
    def apply(self, images: Tensor) -> Tensor:
        """Compute the operation on checked images, B >= 1, float32 or float64."""


class _StraightThrough(torch.autograd.Function):
    @staticmethod
    def forward(ctx, images, values):
        ctx.set_materialize_grads(False)  # no gradient is not one of zeros
        return values.view_as(values)

    @staticmethod
    def backward(ctx, gradient):
        return gradient, None


def straight_through(images: Tensor, values: Tensor) -> Tensor:
    """Return `values` bit for bit, with the identity as gradient to `images`; both have the same
    shape and dtype."""
    return _StraightThrough.apply(images, values.detach())


def output_of(part: Callable[[Tensor], Tensor], images: Tensor) -> Tensor:
    """Return the images that a network or another callable makes of images (B, 3, H, W), clipped to
    [0, 1], in their dtype; the gradient is that of the unclipped ones. A callable that changes the
    images' shape, or returns anything but a tensor, is refused: ValueError."""
    out = part(images.clone())  # it may work in place
    if not isinstance(out, Tensor) or out.shape != images.shape:
        name = getattr(part, "__name__", type(part).__name__)
        got = f"a {type(out).__name__}: pass a function that picks the images of it"
        if isinstance(out, Tensor):
            got = f"{tuple(out.shape)}"
        raise ValueError(
            f"a defence must keep the images' shape {tuple(images.shape)}; {name} gave {got}."
        )
    return straight_through(out, out.clamp(0, 1)).to(images.dtype)
