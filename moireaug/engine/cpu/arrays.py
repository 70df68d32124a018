"""Tensors as arrays that kernels read and fill."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor


def array_of(tensor: Tensor) -> np.ndarray:
    """Return a tensor's values, contiguous."""
    return tensor.detach().contiguous().numpy()


def empty(*shape: int) -> Tensor:
    """Return an uninitialised tensor, float32. NumPy asks for huge pages where it is large; with
    small ones a large photo takes a fifth longer."""
    return torch.from_numpy(np.empty(shape, np.float32))
