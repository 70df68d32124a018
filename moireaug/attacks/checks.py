"""Checks of an attack's arguments: settings out of range, labels and logits that do not match, and
models without an answer."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from moireaug.attacks.losses import has_prediction
from moireaug.common.argument_checks import is_finite


class NoAnswerError(ValueError):
    """A model whose logits are not finite for any of the images, before any attack: broken, not
    robust."""


def check_eps(eps: object) -> None:
    """Refuse an `eps` that is not one number in [0, 1]: ValueError."""
    if not is_finite(eps) or eps < 0:
        is_list = isinstance(eps, (Sequence, np.ndarray, Tensor)) and not isinstance(eps, str)
        advice = " Make one attack per value." if is_list else ""
        raise ValueError(f"eps must be a number >= 0 in [0, 1] units; got {eps!r}.{advice}")
    if eps > 1:
        raise ValueError(
            f"eps is in [0, 1] units, where 1 is full scale; got {eps!r}. Divide by 255?"
        )


def as_tensor(array: np.ndarray, name: str) -> Tensor:
    """Return a NumPy array as a tensor on the CPU, of the same dtype, and refuse one that does not
    hold numbers: TypeError."""
    try:
        return torch.from_numpy(np.array(array, array.dtype.newbyteorder("=")))
    except TypeError:
        raise TypeError(f"{name} must hold numbers; got an array of {array.dtype}.") from None


def check_labels(labels: Tensor | np.ndarray, n: int, name: str) -> Tensor:
    """Return labels (n,) as int64, and refuse any but integers >= 0 in a tensor or NumPy array:
    TypeError or ValueError."""
    labels = as_tensor(labels, name) if isinstance(labels, np.ndarray) else labels
    is_numeric = isinstance(labels, Tensor) and labels.dtype != torch.bool
    if not is_numeric or labels.is_floating_point() or labels.is_complex():
        raise TypeError(
            f"{name} must be an integer tensor or array of class indices; got "
            f"{getattr(labels, 'dtype', type(labels))}."
        )
    if labels.shape != (n,):
        raise ValueError(
            f"{name} must have the shape ({n},), one class per image; got {tuple(labels.shape)}."
        )
    labels = labels.long()  # torch compares few unsigned integers
    if n and labels.min() < 0:
        raise ValueError(f"{name} must be class indices >= 0; got {int(labels.min())}.")
    return labels


def check_goals(
    images: Tensor, labels: Tensor, targets: Tensor | None
) -> tuple[Tensor, Tensor | None]:
    """Return copies of labels and targets, (n,) int64 on the images' device, and refuse them as
    `check_labels` does, and a target that is the label."""
    labels = check_labels(labels, len(images), "labels").to(images.device).clone()
    if targets is None:
        return labels, None
    targets = check_labels(targets, len(images), "targets").to(images.device).clone()
    same = (targets == labels).nonzero().flatten().tolist()
    if same:
        raise ValueError(
            f"targets must be other classes than the labels; {len(same)} of {len(labels)} images "
            f"have their label as target (image {same[0]}: class {int(labels[same[0]])}). Leave "
            "targets out for an untargeted attack."
        )
    return labels, targets


def check_classes(labels: Tensor, logits: Any, *, rejects: bool = False) -> None:
    """Refuse anything but logits (n, K) of two classes or more, and labels (n,) that are not below
    K: ValueError.

    Args:
        rejects: whether the logits have one more column, that of rejecting the image.
    """
    check_is_tensor(logits)
    if logits.ndim != 2 or len(logits) != len(labels):
        raise ValueError(
            f"the model must return logits (B, K); got {tuple(logits.shape)} for {len(labels)} "
            "images."
        )
    n_classes = logits.shape[1] - rejects
    if n_classes < 2:
        raise ValueError(
            f"the model must return the logits of at least two classes; got {n_classes}. For a "
            "single logit z of a binary classifier, return (0, z)."
        )
    if not logits.is_floating_point():
        raise ValueError(
            f"the model must return logits in floating point; got {logits.dtype}. Convert them: "
            "lambda images: model(images).float()."
        )
    if len(labels) and labels.max() >= n_classes:
        raise ValueError(
            f"labels and targets must lie in [0, {n_classes - 1}], the model's classes; got "
            f"{int(labels.max())}. A class_index file maps a folder's classes to a pretrained "
            "model's."
        )


def check_is_tensor(logits: Any) -> None:
    """Refuse a model's output that is no tensor, and say how to pick its logits: ValueError."""
    if not isinstance(logits, Tensor):
        raise ValueError(
            f"the model must return a tensor of logits (B, K); got {_describe_output(logits)}"
        )


def _describe_output(output: Any) -> str:
    """Return a sentence on a model's output that is not logits, and how to wrap the model."""
    description, selector = f"a {type(output).__name__}.", ""
    if isinstance(output, Mapping) and output:
        keys = list(output)
        description = f"a {type(output).__name__} of {', '.join(map(repr, keys[:5]))}."
        key = "logits" if "logits" in keys else keys[0]
        selector = f"[{key!r}]"
    elif isinstance(output, (tuple, list)) and output:
        description, selector = f"a {type(output).__name__} of {len(output)}.", "[0]"
    elif hasattr(output, "logits"):
        selector = ".logits"
    if not selector:
        return description
    wrapped = f"lambda images: model(images){selector}"
    return f"{description} Call model.eval(), and pass a function that picks its logits: {wrapped}."


def check_answers(logits: Tensor, model: Callable[[Tensor], Tensor], images: Tensor) -> None:
    """Refuse a model without an answer to any of the clean images: NoAnswerError. The model is
    called only where no row of `logits` is finite."""
    if not len(logits) or has_prediction(logits).any():
        return
    with torch.no_grad():
        clean_logits = model(images.clone())
    if not has_prediction(clean_logits).any():
        raise NoAnswerError(
            f"the model's logits are NaN or infinite for all {len(images)} clean images: it is "
            "broken, not robust. Look for NaN in its weights, or for an overflow in half precision."
        )
