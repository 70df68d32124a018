"""Confidence intervals."""

from __future__ import annotations

import math

import torch
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


def paired_gain(ours: Tensor, theirs: Tensor) -> tuple[float, float, float]:
    """Return the difference of two accuracies on the same images, with its 95 % interval: (gain,
    low, high).

    Args:
        ours, theirs: (n,) bool, whether each model classifies an image correctly.

    The interval is Agresti and Min's (2005): half an image is added to each of the four outcomes,
    so that it keeps its width where the two models agree on every image.

    Raises:
        ValueError, TypeError: outcomes that are not two bool tensors of one length.
    """
    for outcomes in (ours, theirs):
        if not isinstance(outcomes, Tensor) or outcomes.dtype != torch.bool:
            got = outcomes.dtype if isinstance(outcomes, Tensor) else type(outcomes).__name__
            raise TypeError(f"outcomes must be a bool tensor (n,); got {got}.")
    if ours.shape != theirs.shape or ours.ndim != 1:
        raise ValueError(
            "outcomes of the same images must have one shape (n,); got "
            f"{tuple(ours.shape)} and {tuple(theirs.shape)}."
        )
    n = len(ours)
    if n == 0:
        return 0.0, -1.0, 1.0
    n_won = int((ours & ~theirs).sum())
    n_lost = int((theirs & ~ours).sum())
    a, b, m = n_won + 0.5, n_lost + 0.5, n + 2.0
    centre = (a - b) / m
    half = Z95 * math.sqrt(max(0.0, (a + b) - (a - b) ** 2 / m)) / m
    return (n_won - n_lost) / n, max(-1.0, centre - half), min(1.0, centre + half)
