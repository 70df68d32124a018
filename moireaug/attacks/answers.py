"""The class that logits predict, or none where they are not finite."""

from __future__ import annotations

import torch
from torch import Tensor

UNDECIDED = -1  # takes the place of a class; labels and targets are never below 0


def has_prediction(logits: Tensor) -> Tensor:
    """Return whether each row of logits (B, K) predicts a class, (B,) bool: its greatest logit is
    finite.

    With a NaN there is no greatest logit. Minus infinity rules a class out, and is allowed beside a
    finite logit.
    """
    return logits.amax(1).isfinite()


def predicted(logits: Tensor) -> Tensor:
    """Return the predicted class of each row of logits (B, K), (B,) int64, or `UNDECIDED`, which
    equals no label: a model without an answer is wrong, whereas `argmax` would return the index of
    its first NaN."""
    return torch.where(has_prediction(logits), logits.argmax(1), UNDECIDED)


def reaches(logits: Tensor, labels: Tensor, targets: Tensor | None) -> Tensor:
    """Return whether each row of logits (B, K) is a success of an attack, (B,) bool: it does not
    predict the label or, with targets, it predicts the target."""
    predictions = predicted(logits)
    return predictions != labels if targets is None else predictions == targets
