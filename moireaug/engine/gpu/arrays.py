"""The numbers of a record on the device of the pictures.

Kernels take what travels together as a NamedTuple: Triton 3.8 passes it as an argument, or, of
constants alone, as one that they are compiled with (its `aggregate`s it passes neither way).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TypeVar

import numpy as np
import torch
import triton.language as tl
from torch import Tensor

from moireaug.engine.exposure_records import Camera

ALIGNMENT = 16  # bytes, which a load of four floats needs
Record = TypeVar("Record", bound=tuple)

# what a kernel adds to its pointer to an image's Camera, float64
CAMERA_FIELDS = tl.constexpr(len(Camera._fields))


def camera_field(name: str) -> Any:
    """Return the place of a field in a Camera."""
    return tl.constexpr(Camera._fields.index(name))


def upload(record: Record, device: torch.device) -> Record:
    """Return a NamedTuple, which may hold others, with tensors of the same dtypes on a device in
    the place of its arrays; by one transfer."""
    arrays = list(_arrays_in(record))
    lengths = [-(-array.nbytes // ALIGNMENT) * ALIGNMENT for array in arrays]
    pinned = device.type != "cpu"
    packed = torch.empty(sum(lengths), dtype=torch.uint8, device="cpu", pin_memory=pinned)
    for array, part in zip(arrays, packed.split(lengths), strict=True):
        flat = np.ascontiguousarray(array).reshape(-1)
        part.numpy()[: array.nbytes] = flat.view(np.uint8)
    parts = iter(packed.to(device, non_blocking=True).split(lengths))
    return _with_tensors(record, parts)


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
