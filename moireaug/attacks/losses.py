"""Logits (B, K) as an attack reads them: the predicted class, or none, and the losses that it
ascends, per image, greater where the attack is nearer to its goal."""

from __future__ import annotations

import math
from typing import Protocol

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


class Loss(Protocol):
    """Take logits (B, K), true classes (B,) int64 and, in a targeted attack, the classes (B,) to
    reach; return losses (B,).

    Differentiable in the logits. Without targets it rises as the prediction moves away from the
    true class, with them as it moves toward the target.
    """

    def __call__(self, logits: Tensor, labels: Tensor, targets: Tensor | None = None) -> Tensor: ...


def _without_class(logits: Tensor, classes: Tensor) -> Tensor:
    """Return the logits with minus infinity for one class of each row."""
    return logits.scatter(1, classes[:, None], float("-inf"))


def _logit_of(logits: Tensor, classes: Tensor) -> Tensor:
    """Return the logit of one class of each row, (B,)."""
    return logits.gather(1, classes[:, None])[:, 0]


def margin(logits: Tensor, labels: Tensor, targets: Tensor | None = None) -> Tensor:
    """Return the best other logit minus the labelled one, (B,); with targets, the target's minus
    the best other one.

    It is positive where, and only where, the attack succeeds. At a tie, argmax decides.
    """
    if targets is not None:
        return -margin(logits, targets)
    return _without_class(logits, labels).amax(1) - _logit_of(logits, labels)


def log_odds(logits: Tensor, labels: Tensor, targets: Tensor | None = None) -> Tensor:
    """Return the log-odds against the label, (B,), or, with targets, for the target: cross-entropy
    without its vanishing gradient.

    -log p_y = softplus(log-odds). Of one photo, both have the same gradient up to the factor
    1 - p_y, which is 0 in float32 for a confident model, and rank the steps alike: every rule takes
    the same steps by either. Where a step sums the gradients of several photos (`eot` above 1),
    cross-entropy weighs each by its factor, the log-odds all alike. With targets, p_y is the
    target's.
    """
    if targets is not None:
        return -log_odds(logits, targets)
    return torch.logsumexp(_without_class(logits, labels), 1) - _logit_of(logits, labels)


def difference_of_logits_ratio(
    logits: Tensor, labels: Tensor, targets: Tensor | None = None
) -> Tensor:
    """Return the difference of logits ratio, DLR (Croce & Hein, 2020, equation 6), (B,), or, with
    targets, the targeted one (equation 7).

    With the logits sorted as z_1 >= z_2 >= ..., they are -(z_y - best other) / (z_1 - z_3) and
    -(z_y - z_t) / (z_1 - (z_3 + z_4) / 2): the same for a model whose logits are all multiplied by
    a number. Where all these logits tie, the denominator is the dtype's machine epsilon, and both
    ratios and their gradients are finite. Where one of them is minus infinity, as for a class that
    the model rules out, the loss is the difference alone.

    Where the label itself is third, the untargeted ratio is 1 whatever its logit is. Its gradient,
    0 in the paper, is then that of the margin alone, so that an attack goes on from there.

    Raises:
        ValueError: logits of fewer than three classes, or, with targets, four.
    """
    n_classes, kind = (3, "") if targets is None else (4, ", targeted,")
    if logits.shape[1] < n_classes:
        raise ValueError(
            f"the loss 'dlr'{kind} needs a model of at least {n_classes} classes; got logits of "
            f"{logits.shape[1]}. Use 'margin'."
        )
    top, classes = logits.topk(n_classes, 1)
    if targets is None:
        lead = margin(logits, labels)
        scale = top[:, 0] - top[:, 2]
        scale = torch.where(classes[:, 2] == labels, scale.detach(), scale)
    else:
        lead = _logit_of(logits, targets) - _logit_of(logits, labels)
        scale = top[:, 0] - (top[:, 2] + top[:, 3]) / 2
    scale = torch.where(scale.isfinite(), scale, 1.0)
    return lead / scale.clamp(min=torch.finfo(logits.dtype).eps)


LOSSES: dict[str, Loss] = {
    "ce": log_odds,
    "margin": margin,
    "dlr": difference_of_logits_ratio,
}


def attack_margin(logits: Tensor, labels: Tensor, targets: Tensor | None = None) -> Tensor:
    """Return the margin (B,) float32 of an attack; without an answer, infinite: no answer is a
    wrong one, and never the target."""
    undecided_margin = math.inf if targets is None else -math.inf
    margins = margin(logits.float(), labels, targets)
    return torch.where(has_prediction(logits), margins, undecided_margin)


def loss_curve(losses: list[Tensor]) -> Tensor:
    """Return the reported losses of some steps as one tensor on the CPU, (steps,) float32."""
    if not losses:
        return torch.zeros(0, dtype=torch.float32, device="cpu")
    return torch.stack(losses).cpu()


def likeliest_wrong_classes(logits: Tensor, labels: Tensor, k: int) -> tuple[Tensor, Tensor]:
    """Return the k greatest logits other than the label's, the greatest first, and their classes,
    int64: (B, k) each, or (B, K - 1) where the model has fewer."""
    values, classes = _without_class(logits, labels).topk(min(k, logits.shape[1] - 1), 1)
    return values, classes
