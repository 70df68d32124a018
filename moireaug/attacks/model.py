"""The attacked model: normalisation inside it, and its state restored after an attack."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence

import torch
from torch import Tensor, nn


class Normalized(nn.Module):
    """Wrap a model of normalised images so that it takes images in [0, 1].

    Args:
        model: (B, C, H, W) normalised images to logits.
        mean, std: per channel, in units of [0, 1] images; ImageNet's by default.

    Raises:
        ValueError: mean and std that are not of length 3, or 1, each; a std that is not above 0.
    """

    mean: Tensor
    std: Tensor

    def __init__(
        self,
        model: nn.Module,
        mean: Sequence[float] = (0.485, 0.456, 0.406),
        std: Sequence[float] = (0.229, 0.224, 0.225),
    ) -> None:
        super().__init__()
        means, stds = torch.as_tensor(mean), torch.as_tensor(std)
        if means.shape != stds.shape or means.shape not in ((1,), (3,)) or not (stds > 0).all():
            raise ValueError(
                "mean and std must each hold one number per channel, 3 or 1 for all, and every std "
                f"must be above 0; got mean = {mean}, std = {std}."
            )
        self.model = model
        self.register_buffer("mean", means.view(-1, 1, 1), persistent=False)
        self.register_buffer("std", stds.view(-1, 1, 1), persistent=False)

    def forward(self, images: Tensor) -> Tensor:
        return self.model((images - self.mean) / self.std)


@contextlib.contextmanager
def evaluating(model: nn.Module | Callable[[Tensor], Tensor]) -> Iterator[None]:
    """Put a model into evaluation mode, and restore every module's own mode on exit, also after an
    error.

    BatchNorm would otherwise update its statistics from the attack's intermediate images. Gradients
    are enabled inside, even under `torch.no_grad` and `torch.inference_mode`, because every attack
    needs them.
    """
    modes = [(m, m.training) for m in model.modules()] if isinstance(model, nn.Module) else []
    try:
        if isinstance(model, nn.Module):
            model.eval()
        with torch.inference_mode(False), torch.enable_grad():
            yield
    finally:
        for module, training in modes:
            module.training = training
