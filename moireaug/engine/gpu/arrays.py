"""Records on the device of the pictures.

Kernels take records as they are: Triton 3.8 passes a NamedTuple as an argument, or one of constants
as what a kernel is compiled with (its own `aggregate` it passes neither way). They compute in
float32; places and phases need more digits.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TypeVar

import numpy as np
import torch
import triton.language as tl
from torch import Tensor

from moireaug.engine.lower.exposure_records import Camera

ALIGNMENT = 16  # bytes, which a load of four floats needs
NARROW = {np.dtype(np.float64): np.float32, np.dtype(np.int64): np.int32}
WIDE_FIELDS = {"cameras", "blur_cameras", "forward", "centres", "start"}  # which keep 64 bits
NOTHING: Any = None  # in place of a field that no kernel reads
Record = TypeVar("Record", bound=tuple)

# what a kernel adds to its pointer to an image's Camera, float64
CAMERA_FIELDS = tl.constexpr(len(Camera._fields))


def camera_field(name: str) -> Any:
    """Return the place of a field in a Camera."""
    return tl.constexpr(Camera._fields.index(name))


def upload(record: Record, device: torch.device) -> Record:
    """Return a NamedTuple, which may hold others, with tensors on a device in the place of its
    arrays, by one transfer: of 32 bits, but for WIDE_FIELDS."""
    record = _narrowed(record)
    arrays = list(_arrays_in(record))
    lengths = [-(-array.nbytes // ALIGNMENT) * ALIGNMENT for array in arrays]
    pinned = device.type != "cpu"
    packed = torch.empty(sum(lengths), dtype=torch.uint8, device="cpu", pin_memory=pinned)
    for array, part in zip(arrays, packed.split(lengths), strict=True):
        part.numpy()[: array.nbytes] = array.reshape(-1).view(np.uint8)
    parts = iter(packed.to(device, non_blocking=True).split(lengths))
    return _with_tensors(record, parts)


def _narrowed(value: Any, name: str = "") -> Any:
    if isinstance(value, np.ndarray):
        dtype = value.dtype if name in WIDE_FIELDS else NARROW.get(value.dtype, value.dtype)
        return np.ascontiguousarray(value, dtype)
    if hasattr(value, "_fields"):
        return value._make(map(_narrowed, value, value._fields))
    return value


def _arrays_in(value: Any) -> Iterator[np.ndarray]:
    if isinstance(value, np.ndarray):
        yield value
    elif hasattr(value, "_fields"):
        for field in value:
            yield from _arrays_in(field)


def _with_tensors(value: Any, parts: Iterator[Tensor]) -> Any:
    """Return a value with the next of the bytes on a device in the place of each array."""
    if isinstance(value, np.ndarray):
        dtype = torch.from_numpy(np.empty(0, value.dtype)).dtype
        return next(parts)[: value.nbytes].view(dtype).reshape(value.shape)
    if hasattr(value, "_fields"):
        return value._make([_with_tensors(field, parts) for field in value])
    return value
