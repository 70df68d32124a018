"""The attacked model: normalisation inside it, its state restored after an attack, and whether it
has a gradient."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import torch
from torch import Tensor, nn

from moireaug.attacks.checks import check_classes
from moireaug.attacks.losses import is_same_answer, rejection_as_label
from moireaug.common.networks import (
    first_weight,
    in_evaluation_mode,
    networks_of,
    rejects_of,
)

# messages of torch where weights and images differ in precision or device, or in channels
TYPE_MISMATCH = r"same dtype|type .* should be the same|expected scalar type"
ONE_CHANNEL_EXPECTED = r"to have 1 channels, but got 3 channels"
NO_GRADIENT_MESSAGE = (
    "the model's logits have no gradient: it runs under torch.no_grad, detaches, is quantised, or "
    "computes in integers or outside torch. Pass a differentiable model, or search without "
    "gradients: attacks.SquareMoire."
)


class Normalized(nn.Module):
    """Wrap a model of normalised images so that it takes images in [0, 1].

    Args:
        model: (B, C, H, W) normalised images to logits.
        mean, std: per channel, in units of [0, 1] images; ImageNet's by default.

    Raises:
        ValueError: mean and std that are not of length 3, or 1, each; a std that is not above 0.
    """

    buffers_follow_images = True
    mean: Tensor
    std: Tensor

    def __init__(
        self,
        model: nn.Module,
        mean: Sequence[float] = (0.485, 0.456, 0.406),
        std: Sequence[float] = (0.229, 0.224, 0.225),
    ) -> None:
        super().__init__()
        means, stds = (torch.as_tensor(t, dtype=torch.float32, device="cpu") for t in (mean, std))
        has_shape = means.shape == stds.shape and means.shape in ((1,), (3,))
        if not (has_shape and torch.cat([means, stds]).isfinite().all() and (stds > 0).all()):
            raise ValueError(
                "mean and std must each be a list of finite numbers, 3 for the channels or 1 for "
                f"all, and every std must be above 0; got mean = {mean}, std = {std}."
            )
        self.model = model
        self.rejects = rejects_of(model)
        self.register_buffer("mean", means.view(-1, 1, 1), persistent=False)
        self.register_buffer("std", stds.view(-1, 1, 1), persistent=False)

    def forward(self, images: Tensor) -> Tensor:
        return self.model((images - self.mean.to(images)) / self.std.to(images))


def _mismatch_message(weight: Tensor | None, images: Tensor | None, reason: str) -> str:
    """Return an error message for images that differ from the model's first weight in precision or
    device; empty where they do not, and the error has another cause.

    Args:
        reason: torch's message, as in "Input type (torch.FloatTensor) and weight type
            (torch.cuda.FloatTensor) should be the same".
    """
    if weight is None or images is None or not re.search(TYPE_MISMATCH, reason):
        return ""
    types = re.findall(r"(\w+Tensor)\)", reason)
    if len(types) > 1 and len(set(types)) == 1:  # only their devices differ
        device = str(weight.device)
        return (
            f"the model is on {device} and does not take these images ({reason}): pass "
            f"images.to({device!r})."
        )
    if weight.dtype == images.dtype:
        return ""
    return (
        f"the model has weights of {weight.dtype} and does not take these images ({reason}): pass "
        f"a function that converts them, as in lambda images: model(images.to({weight.dtype}))."
    )


@contextlib.contextmanager
def evaluating(model: Callable[[Tensor], Tensor], images: Tensor | None = None) -> Iterator[None]:
    """Prepare a model for an attack: put its networks into evaluation mode, see
    `networks.in_evaluation_mode`, and enable gradients, even under `torch.no_grad` and
    `torch.inference_mode`, because every attack needs them.

    Args:
        images: (B, 3, H, W) images that the model is called on, for the errors below.

    Raises:
        TypeError: in place of torch's RuntimeError where the images differ from the networks'
            weights in precision or device, or the model takes one channel.
    """
    try:
        with torch.inference_mode(False), torch.enable_grad(), in_evaluation_mode(model):
            yield
    except RuntimeError as error:
        if re.search(ONE_CHANNEL_EXPECTED, str(error)):
            raise TypeError(
                f"the model takes images of one channel, and photos are RGB ({error}): pass a "
                "function that gives it their luma, as in lambda images: "
                "model(rgb_to_grayscale(images)), with "
                "torchvision.transforms.v2.functional.rgb_to_grayscale."
            ) from error
        reason = str(error).partition("\n")[0]
        if message := _mismatch_message(first_weight(*networks_of(model)), images, reason):
            raise TypeError(message) from error
        raise


def check_differentiable(logits: Tensor) -> None:
    """Refuse logits without a gradient: ValueError."""
    if not logits.requires_grad:
        raise ValueError(NO_GRADIENT_MESSAGE)


def check_gradient(gradients: Sequence[Tensor | None]) -> None:
    """Refuse gradients none of which is defined: ValueError."""
    if all(gradient is None for gradient in gradients):
        raise ValueError(NO_GRADIENT_MESSAGE)


def watched_copy(images: Tensor) -> Tensor:
    """Return a copy of images for a model, which may work in place. A backward pass that brings no
    gradient to it, because an operator of the model has none, raises the ValueError of
    `check_gradient`: on its way through a camera, no gradient would become one of zeros."""
    copy = images.clone()
    if copy.grad_fn is not None and not torch.compiler.is_compiling():
        copy.grad_fn.register_prehook(check_gradient)
    return copy


def keep_undefined(logits: Tensor) -> None:
    """Let a backward pass from logits leave a gradient undefined where it is: an autograd.Function
    is else given zeros in its place, and passes them on."""
    nodes: list[Any] = [logits.grad_fn]
    visited: set[Any] = {None}
    for node in nodes:  # which grows
        if node not in visited and node.next_functions:  # else a weight's own, which stays
            visited.add(node)
            node.register_hook(_undefined_if_undefined)
            nodes += [following for following, _ in node.next_functions]


def _undefined_if_undefined(
    inward: Sequence[Tensor | None], outward: Sequence[Tensor | None]
) -> tuple[None, ...] | None:
    """Return no gradients in place of a node's gradients in its inputs, where those in its results
    are not defined."""
    return (None,) * len(inward) if all(gradient is None for gradient in outward) else None


def attacked_logits(
    model: Callable[[Tensor], Tensor], images: Tensor, labels: Tensor, *, rejects: bool
) -> Tensor:
    """Return the logits (B, K) that an attack on images (B, 3, H, W) with labels (B,) judges:
    rejecting an image is no success, see `rejection_as_label`. Differentiable; a model without a
    gradient is refused by a backward pass, see `watched_copy`.

    rejects: `rejects_of(model)`, which takes too long for every step.
    """
    logits = model(watched_copy(images))
    if not rejects:
        return logits
    check_classes(labels, logits, rejects=True)
    return rejection_as_label(logits, labels)


def require_gradient(
    model: Callable[[Tensor], Tensor],
    images: Tensor,
    labels: Tensor,
    gradients: Sequence[Tensor | None],
    *,
    rejects: bool,
) -> None:
    """Refuse a model that has no gradient in images (B, 3, H, W), as `check_gradient` does, by the
    gradients that a step found. Where they are all zero, the model is asked again, to tell zeros
    that are real from those that stand for no gradient."""
    check_gradient(gradients)
    if not len(images) or any(bool(slope.any()) for slope in gradients if slope is not None):
        return
    images = images.detach().requires_grad_()
    logits = attacked_logits(model, images, labels, rejects=rejects)
    keep_undefined(logits)
    torch.autograd.grad(logits.sum(), images, allow_unused=True)


def logits_without_gradient(model: Callable[[Tensor], Tensor], images: Tensor) -> Tensor:
    """Return a model's logits (B, K) of images (B, 3, H, W), without gradients; its state is
    restored."""
    with evaluating(model, images), torch.no_grad():
        return model(images.clone())  # it may work in place


def class_count(model: Callable[[Tensor], Tensor], images: Tensor, labels: Tensor) -> int:
    """Return the number of classes of a model, by its answer to the first of some images
    (B, 3, H, W), and refuse logits and labels as `check_classes` does."""
    logits = logits_without_gradient(model, images[:1])
    rejects = rejects_of(model)
    check_classes(labels.amax(0, keepdim=True), logits, rejects=rejects)
    return logits.shape[1] - rejects


def repeats_answers(model: Callable[[Tensor], Tensor], images: Tensor) -> Tensor:
    """Return whether a model, asked twice, answers each image (B, 3, H, W) the same, (B,) bool; see
    `is_same_answer`. Its state is restored."""
    # in one block: a layer may draw from the beginning each time that it enters evaluation mode
    with evaluating(model, images), torch.no_grad():
        return is_same_answer(model(images.clone()), model(images.clone()))
