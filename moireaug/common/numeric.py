"""Arithmetic in the right dtype, and with the right gradient at bounds."""

from __future__ import annotations

import math
from types import ModuleType
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd import forward_ad

LUMA_WEIGHTS = (0.299, 0.587, 0.114)  # ITU-R BT.601, as in torchvision, PIL and OpenCV


def library_of(values: Tensor | np.ndarray) -> ModuleType:
    """Return the library of an array, torch or numpy, whose functions it takes."""
    return torch if isinstance(values, Tensor) else np


def array_like(values: Any, like: Any) -> Any:
    """Return numbers as an array of another's library, dtype and device."""
    return like.new_tensor(values) if isinstance(like, Tensor) else np.array(values, like.dtype)


def clip(x: Tensor) -> Tensor:
    """Clip to [0, 1] with gradient 1 on both bounds, where `torch.clamp` passes none since torch
    2.14 and would hide black and white pixels from an attack, and 0 outside."""
    if not _has_gradient(x):
        return x.clamp(0, 1)
    return torch.where((x < 0) | (x > 1), x.detach().clamp(min=0, max=1), x)


def clip_straight_through(x: Tensor) -> Tensor:
    """Put back into [0, 1] what lies there but for rounding, with gradient 1 everywhere."""
    return x + (x.detach().clamp(0, 1) - x.detach())


def saturate(x: Tensor) -> Tensor:
    """Clip to at most 1; gradient as in `clip`."""
    return torch.where(x > 1, torch.ones_like(x), x) if _has_gradient(x) else x.clamp(max=1)


def _has_gradient(x: Tensor) -> bool:
    """Return whether a derivative may be asked for, backward or forward."""
    return x.requires_grad or may_be_dual(x)


def may_be_dual(x: Tensor) -> bool:
    """Return whether a forward derivative may be asked for: a torch.func transform hides it."""
    if torch._C._are_functorch_transforms_active():
        return True
    return not torch.compiler.is_compiling() and forward_ad.unpack_dual(x).tangent is not None


def has_func_gradient(x: Tensor) -> bool:
    """Return whether `torch.func.grad`, or what is built on it, follows a tensor."""
    functorch = torch._C._functorch
    while functorch.is_functorch_wrapped_tensor(x):
        if functorch.is_gradtrackingtensor(x):
            return True
        x = functorch.get_unwrapped(x)
    return False


def is_batched(x: Tensor) -> bool:
    """Return whether a tensor stands for several: under `torch.func.vmap`, or the older one behind
    `is_grads_batched`."""
    functorch = torch._C._functorch
    return functorch.is_batchedtensor(x) or functorch.is_legacy_batchedtensor(x)


def per_image(values: Tensor, like: Tensor) -> Tensor:
    """Return values (B,) as (B, 1, ...), with as many axes as the tensor `like` that they scale,
    and of its dtype."""
    return values.to(like.dtype)[(slice(None), *[None] * (like.ndim - 1))]


def select_rows(mask: Tensor, a: Tensor, b: Tensor) -> Tensor:
    """Return `a` in the rows where the mask (B,) is True, `b` in the others."""
    return torch.where(mask.view(-1, *[1] * (a.ndim - 1)), a, b)


def mix_colours(matrix: Tensor, light: Tensor) -> Tensor:
    """Return colours (B, 3, h, w) of light of the same shape by matrices (B, 3, 3); not as a matrix
    product, for which a GPU may round to ten bits."""
    return (matrix.to(light.dtype)[..., None, None] * light[:, None]).sum(2)


def luma(images: Tensor) -> Tensor:
    """Return the luma (B, 1, H, W) of images (B, 3, H, W)."""
    return (images * images.new_tensor(LUMA_WEIGHTS)[:, None, None]).sum(1, keepdim=True)


def repeat_edges(planes: Tensor, left: int, right: int, top: int, bottom: int) -> Tensor:
    """Return planes (B, C, h, w) with the pixels of their edges repeated past them: as F.pad, on
    whose gradient torch.compile fails in a layout that it chooses itself."""
    for axis, before, after in ((2, top, bottom), (3, left, right)):
        first, last = planes.narrow(axis, 0, 1), planes.narrow(axis, planes.shape[axis] - 1, 1)
        planes = torch.cat([*[first] * before, planes, *[last] * after], axis)
    return planes


def mirrored_indices(size: int, before: int, after: int, device: torch.device) -> Tensor:
    """Return indices (before + size + after,) that extend an axis by its mirror image, edge pixels
    twice, c b a | a b c | c b, by any amount: scipy's "reflect", numpy's "symmetric"."""
    index = torch.arange(-before, size + after, device=device) % (2 * size)
    return torch.where(index < size, index, 2 * size - 1 - index)


def as_dtype(values: Tensor, dtype: torch.dtype) -> Tensor:
    """Return values in another dtype, rounded if it has whole numbers alone."""
    return values.to(dtype) if dtype.is_floating_point else values.round().to(dtype)


def sinc(x: Tensor) -> Tensor:
    """Return sin(pi x) / (pi x). torch.sinc is not vectorised: it takes five times as long."""
    x, least = math.pi * x, torch.finfo(x.dtype).eps ** 0.5
    large = x.abs().clamp(min=least)
    value = torch.sin(large) / large
    if not _has_gradient(x):
        return value
    small = x.clamp(-least, least)
    return value * (1 - small * small / 6)  # a factor of 1, but for its derivatives near 0


def is_transformed() -> bool:
    """Return whether values are unknown: a graph is traced, or a torch.func transform is at
    work."""
    return torch.compiler.is_compiling() or torch._C._are_functorch_transforms_active()


def widen_half(values: Tensor) -> Tensor:
    """Return half precision as float32, other dtypes unchanged."""
    return values.float() if values.dtype in (torch.float16, torch.bfloat16) else values


def as_float(images: Tensor) -> Tensor:
    """Return uint8 images as float32 in [0, 1], others unchanged."""
    return images.float() / 255 if images.dtype == torch.uint8 else images
