"""Confidence intervals."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from torch import Tensor

Z95 = 1.959964


def wilson(hits: float, n: float) -> tuple[float, float]:
    """Return the 95 % interval of a proportion (Wilson, 1927); (0, 1) where nothing was counted.

    Raises:
        ValueError: more hits than n, or fewer than 0.
    """
    if n == 0:
        return 0.0, 1.0
    if not 0 <= hits <= n:
        raise ValueError(f"hits must lie in [0, n]; got {hits} of {n}.")
    p, z2 = hits / n, Z95**2
    centre = (p + z2 / (2 * n)) / (1 + z2 / n)
    half = Z95 / (1 + z2 / n) * math.sqrt(p * (1 - p) / n + z2 / (4 * n * n))
    return max(0.0, centre - half), min(1.0, centre + half)


def paired_gain(ours: ArrayLike, theirs: ArrayLike) -> tuple[float, float, float]:
    """Return the difference of two accuracies on the same images, with its 95 % interval: (gain,
    low, high).

    Args:
        ours, theirs: (n,) bool, whether each model classifies an image correctly: tensors, arrays,
            or the column `correct` of a cell in the frames of two evaluations.

    The interval is Agresti and Min's (2005): half an image is added to each of the four outcomes,
    so that it keeps its width where the two models agree on every image.

    Raises:
        ValueError, TypeError: outcomes that are not bool, or not of one length.
    """
    ours_right, theirs_right = _outcomes(ours), _outcomes(theirs)
    if ours_right.shape != theirs_right.shape or ours_right.ndim != 1:
        raise ValueError(
            "outcomes of the same images must have one shape (n,); got "
            f"{ours_right.shape} and {theirs_right.shape}."
        )
    n = len(ours_right)
    if n == 0:
        return 0.0, -1.0, 1.0
    n_won = int((ours_right & ~theirs_right).sum())
    n_lost = int((theirs_right & ~ours_right).sum())
    a, b, m = n_won + 0.5, n_lost + 0.5, n + 2.0
    centre = (a - b) / m
    half = Z95 * math.sqrt(max(0.0, (a + b) - (a - b) ** 2 / m)) / m
    return (n_won - n_lost) / n, max(-1.0, centre - half), min(1.0, centre + half)


def _outcomes(outcomes: ArrayLike) -> np.ndarray:
    array = np.asarray(outcomes.cpu() if isinstance(outcomes, Tensor) else outcomes)
    if array.dtype != bool:
        raise TypeError(f"outcomes must be bool, (n,); got {array.dtype}.")
    return array
