"""What an attack refuses: labels and logits that do not belong together, and models without an
answer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor

from moireaug.attacks.answers import decided


class NoAnswerError(ValueError):
    """A model whose logits are not finite for any of the images, before any attack: broken, not
    robust."""


def check_labels(labels: Tensor, n: int, name: str) -> Tensor:
    """Refuse what is not (n,) integers >= 0.

    Raises:
        TypeError, ValueError: with what was got and what is allowed.
    """
    if not isinstance(labels, Tensor) or labels.is_floating_point() or labels.dtype == torch.bool:
        raise TypeError(
            f"{name} must be an integer tensor of class indices; got "
            f"{getattr(labels, 'dtype', type(labels))}."
        )
    if labels.shape != (n,):
        raise ValueError(
            f"{name} must have the shape ({n},), one class an image; got {tuple(labels.shape)}."
        )
    if n and labels.min() < 0:
        raise ValueError(f"{name} must be class indices >= 0; got {int(labels.min())}.")
    return labels.long()


def check_goals(
    images: Tensor, labels: Tensor, targets: Tensor | None
) -> tuple[Tensor, Tensor | None]:
    """Return copies of labels and targets, (n,) int64 on the images' device.

    Raises:
        TypeError, ValueError: as `check_labels`, and where a target is the label.
    """
    labels = check_labels(labels, len(images), "labels").to(images.device).clone()
    if targets is None:
        return labels, None
    targets = check_labels(targets, len(images), "targets").to(images.device).clone()
    same = (targets == labels).nonzero().flatten().tolist()
    if same:
        raise ValueError(
            f"targets must be other classes than the labels; {len(same)} of {len(labels)} images "
            f"have the same as both (image {same[0]}: class {int(labels[same[0]])}). Leave targets "
            "out for an untargeted attack."
        )
    return labels, targets


def check_classes(labels: Tensor, logits: Any, views: int) -> None:
    """Refuse what is not logits (views * n, K), and labels that are not below K."""
    if not isinstance(logits, Tensor):
        raise ValueError(
            f"the model must return a tensor of logits (B, K); got {_described(logits)}"
        )
    if logits.ndim != 2 or len(logits) != len(labels) * views:
        raise ValueError(
            f"the model must return logits (B, K); got {tuple(logits.shape)} for {len(labels)} "
            "images."
        )
    if len(labels) and labels.max() >= logits.shape[1]:
        raise ValueError(
            f"labels and targets must lie in [0, {logits.shape[1] - 1}], the model's classes; got "
            f"{int(labels.max())}. A class_index file maps a folder's classes to a pretrained "
            "model's."
        )


def _described(found: Any) -> str:
    """Return what a model returned instead of logits, and how to wrap it."""
    what, pick = f"a {type(found).__name__}.", ""
    if isinstance(found, Mapping) and found:
        keys = list(found)
        what = f"a {type(found).__name__} of {', '.join(map(repr, keys[:5]))}."
        key = "logits" if "logits" in keys else keys[0]
        pick = f"[{key!r}]"
    elif isinstance(found, (tuple, list)) and found:
        what, pick = f"a {type(found).__name__} of {len(found)}.", "[0]"
    elif hasattr(found, "logits"):
        pick = ".logits"
    if not pick:
        return what
    wrapped = f"lambda images: model(images){pick}"
    return f"{what} Put model.eval(), and pass what picks its logits: {wrapped}."


def check_answers(logits: Tensor, model: Callable[[Tensor], Tensor], images: Tensor) -> None:
    """Refuse a model that has no answer to any of the clean images; it is asked only where it had
    none in `logits`.

    Raises:
        NoAnswerError: a ValueError.
    """
    if not len(logits) or decided(logits).any():
        return
    with torch.no_grad():
        clean = model(images)
    if not decided(clean).any():
        raise NoAnswerError(
            f"the model's logits are NaN or infinite for all {len(images)} clean images: it is "
            "broken, not robust. Look for NaN in its weights, or for an overflow in half precision."
        )


def check_gradient(logits: Tensor) -> None:
    """Refuse logits that no gradient leads back from."""
    if not logits.requires_grad:
        raise ValueError(
            "the model's logits have no gradient: it runs under torch.no_grad, detaches, rounds or "
            "leaves torch. Pass a differentiable model, or search without gradients: "
            "attacks.SquareMoire."
        )
