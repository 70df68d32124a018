"""The attacked model: its normalisation put inside, its state left as it was found."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence

import torch
from torch import Tensor, nn


class Normalized(nn.Module):
    """A model that takes [0, 1] images, around one that takes normalised ones.

    Args:
        model: (B, C, H, W) normalised images to logits.
        mean, std: per channel, in units of [0, 1] images; ImageNet's by default.
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
        if len(mean) != len(std) or min(std) <= 0:
            raise ValueError(
                f"mean and std must be as many positive std as mean; got mean = {mean}, std = "
                f"{std}."
            )
        self.model = model
        self.register_buffer("mean", torch.tensor(mean).view(-1, 1, 1), persistent=False)
        self.register_buffer("std", torch.tensor(std).view(-1, 1, 1), persistent=False)

    def forward(self, images: Tensor) -> Tensor:
        return self.model((images - self.mean) / self.std)


@contextlib.contextmanager
def evaluating(model: nn.Module | Callable[[Tensor], Tensor]) -> Iterator[None]:
    """Put a model into evaluation mode inside, and every module back into its own mode outside,
    also after an error.

    BatchNorm would otherwise learn the attack's intermediate images. Gradients are enabled inside,
    even under `torch.no_grad` and `torch.inference_mode`, because every attack needs them.
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
