"""The numbers of a record on the device of the pictures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
import triton.language as tl
from torch import Tensor

from moireaug.engine.lower.exposure_records import Camera

ALIGNMENT = 16  # bytes, which a load of four floats needs

# what a kernel adds to its pointer to an image's Camera, float64
CAMERA_FIELDS = tl.constexpr(len(Camera._fields))


def camera_field(name: str) -> Any:
    """Return the place of a field in a Camera."""
    return tl.constexpr(Camera._fields.index(name))


def upload(arrays: Mapping[str, np.ndarray], device: torch.device) -> dict[str, Tensor]:
    """Return arrays as tensors of their dtypes on a device, by one transfer."""
    starts, end = {}, 0
    for name, array in arrays.items():
        starts[name] = end
        end += -(-array.nbytes // ALIGNMENT) * ALIGNMENT
    packed = torch.empty(end, dtype=torch.uint8, device="cpu", pin_memory=device.type != "cpu")
    bytes_ = packed.numpy()
    for name, array in arrays.items():
        flat = np.ascontiguousarray(array).reshape(-1)
        bytes_[starts[name] : starts[name] + array.nbytes] = flat.view(np.uint8)
    there = packed.to(device, non_blocking=True)
    tensors = {}
    for name, array in arrays.items():
        part = there[starts[name] : starts[name] + array.nbytes]
        dtype = torch.from_numpy(np.empty(0, array.dtype)).dtype
        tensors[name] = part.view(dtype).reshape(array.shape)
    return tensors
