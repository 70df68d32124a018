"""What an attack ascends: per-image losses of logits (B, K) and labels (B,), greater where the model is more wrong."""

from __future__ import annotations

from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor


def _without(logits: Tensor, labels: Tensor) -> Tensor:
    """The logits with the labelled class's at minus infinity."""
    return logits.scatter(1, labels[:, None], float("-inf"))


def margin(logits: Tensor, labels: Tensor) -> Tensor:
    """Best other logit minus the labelled one, (B,): positive where, and only where, the label is not predicted.

    A tie counts as predicted wrongly only if argmax says so; see `Attack`.
    """
    return _without(logits, labels).amax(1) - logits.gather(1, labels[:, None])[:, 0]


def cross_entropy(logits: Tensor, labels: Tensor) -> Tensor:
    """Cross-entropy's direction without its vanishing length: the log-odds against the label, (B,).

    -log p_y = softplus(logsumexp of the other logits - z_y). Both have the same gradient up to the factor 1 - p_y,
    which is 0 in float32 for a confident model; the sign steps of an attack only need the direction.
    """
    return torch.logsumexp(_without(logits, labels), 1) - logits.gather(1, labels[:, None])[:, 0]


def difference_of_logits_ratio(logits: Tensor, labels: Tensor) -> Tensor:
    """The margin over the difference of the greatest and the third greatest logit (DLR, Croce & Hein 2020, equation 6),
    (B,): the same for a model whose logits are all multiplied by a number.

    Where the label itself is third, the ratio is 1 whatever that logit is. Its gradient is then that of the margin
    alone, so that an attack which wants to raise the label, a targeted one, is not stuck there.

    Raises:
        ValueError: logits of fewer than three classes.
    """
    if logits.shape[1] < 3:
        raise ValueError(
            f"the loss 'dlr' needs a model of at least 3 classes; got logits of {logits.shape[1]}. Use 'margin'."
        )
    top, places = logits.topk(3, 1)
    spread = top[:, 0] - top[:, 2]
    spread = torch.where(places[:, 2] == labels, spread.detach(), spread)
    return margin(logits, labels) / spread.clamp(min=torch.finfo(logits.dtype).eps)


LOSSES: dict[str, Callable[[Tensor, Tensor], Tensor]] = {
    "ce": cross_entropy,
    "margin": margin,
    "dlr": difference_of_logits_ratio,
}


def reported(logits: Tensor, labels: Tensor) -> Tensor:
    """Mean cross-entropy, as a curve of it is usually shown."""
    return F.cross_entropy(logits.detach().float(), labels)
