"""The class that logits predict, or none where they are not finite or the model rejects the
image."""

from __future__ import annotations

import torch
from torch import Tensor

# in place of a class; labels and targets are never below 0
UNDECIDED = -1
REJECTED = -2


def has_prediction(logits: Tensor) -> Tensor:
    """Return whether each row of logits (B, K) predicts a class, (B,) bool: its greatest logit is
    finite.

    With a NaN there is no greatest logit. Minus infinity rules a class out, and is allowed beside a
    finite logit.
    """
    return logits.amax(1).isfinite()


def predicted(logits: Tensor, *, rejects: bool = False) -> Tensor:
    """Return the predicted class of each row of logits (B, K), (B,) int64, or `UNDECIDED`, which
    equals no label: a model without an answer is wrong, whereas `argmax` would return the index of
    its first NaN.

    Args:
        rejects: whether the last logit is that of rejecting the image, which gives `REJECTED`.
    """
    classes = logits.argmax(1)
    if rejects:
        classes = torch.where(classes == logits.shape[1] - 1, REJECTED, classes)
    return torch.where(has_prediction(logits), classes, UNDECIDED)


def is_same_answer(logits: Tensor, other: Tensor) -> Tensor:
    """Return whether two answers to each image, logits (B, K), are the same but for a thousandth of
    the logits, (B,) bool: rounding is no other answer."""
    if not len(logits):
        return torch.ones(0, dtype=torch.bool, device=logits.device)
    size = logits.abs().float().nan_to_num(0, 0, 0).median().item()
    return torch.isclose(logits, other, rtol=1e-3, atol=1e-3 * size, equal_nan=True).all(1)


def rejection_as_label(logits: Tensor, labels: Tensor) -> Tensor:
    """Return the logits (B, K) of a model whose last logit (B, K + 1) rejects the image, with the
    greater of that and the label's in the label's place: to an attack, a rejected image is no
    better than one that is classified correctly. Differentiable."""
    classes, rejection = logits[:, :-1], logits[:, -1:]
    labelled = torch.maximum(classes.gather(1, labels[:, None]), rejection)
    return classes.scatter(1, labels[:, None], labelled)


def is_success(logits: Tensor, labels: Tensor, targets: Tensor | None) -> Tensor:
    """Return whether each row of logits (B, K) is a success of an attack, (B,) bool: it does not
    predict the label or, with targets, it predicts the target."""
    predictions = predicted(logits)
    return predictions != labels if targets is None else predictions == targets
