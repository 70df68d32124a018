"""What logits say: a class, or nothing where they are not finite."""

from __future__ import annotations

import torch
from torch import Tensor

UNDECIDED = -1  # stands in the place of a class; no label and no target is below 0


def decided(logits: Tensor) -> Tensor:
    """Return which rows of logits (B, K) name a class, (B,) bool: those whose greatest logit is
    finite.

    A NaN leaves no greatest. Minus infinity rules a class out, and is no fault beside a finite
    logit.
    """
    return logits.amax(1).isfinite()


def predicted(logits: Tensor) -> Tensor:
    """Return the predicted class of each row of logits (B, K), (B,) int64, or `UNDECIDED`, which
    equals no label: a model that has no answer is wrong, whereas `argmax` would give the place of
    its first NaN."""
    return torch.where(decided(logits), logits.argmax(1), UNDECIDED)
