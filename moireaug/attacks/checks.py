"""What an attack refuses: labels and logits that do not belong together."""

from __future__ import annotations

import torch
from torch import Tensor


def check_labels(labels: Tensor, n: int, name: str) -> Tensor:
    """Refuse what is not (n,) integers >= 0.

    Raises:
        TypeError, ValueError: with what was got and what is allowed.
    """
    if not isinstance(labels, Tensor) or labels.is_floating_point() or labels.dtype == torch.bool:
        raise TypeError(
            f"{name} must be an integer tensor of class indices; got {getattr(labels, 'dtype', type(labels))}."
        )
    if labels.shape != (n,):
        raise ValueError(f"{name} must have the shape ({n},), one class an image; got {tuple(labels.shape)}.")
    if n and labels.min() < 0:
        raise ValueError(f"{name} must be class indices >= 0; got {int(labels.min())}.")
    return labels.long()


def check_classes(labels: Tensor, logits: Tensor, views: int) -> None:
    """Refuse logits that are not (views * n, K), and labels that are not below K."""
    if logits.ndim != 2 or len(logits) != len(labels) * views:
        raise ValueError(f"the model must return logits (B, K); got {tuple(logits.shape)} for {len(labels)} images.")
    if len(labels) and labels.max() >= logits.shape[1]:
        raise ValueError(
            f"labels and targets must lie in [0, {logits.shape[1] - 1}], the model's classes; got {int(labels.max())}. "
            "A class_index file maps a folder's classes to a pretrained model's."
        )
