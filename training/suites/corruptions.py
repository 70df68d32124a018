"""Images corrupted without camera or attacker: noise, blur, JPEG and contrast, after ImageNet-C
(Hendrycks & Dietterich, 2019)."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from kornia.enhance import adjust_contrast_with_mean_subtraction
from kornia.filters import gaussian_blur2d
from torch import Tensor

from moireaug.camera.effects.jpeg import jpeg
from moireaug.common.numeric import clip
from moireaug.evaluation.conditions import Condition, EvalBatch


def gaussian_noise(images: Tensor, sigma: float, generator: torch.Generator) -> Tensor:
    """Add normal noise of standard deviation `sigma`, in [0, 1] units."""
    noise = torch.randn(images.shape, generator=generator, dtype=torch.float32, device="cpu")
    return clip(images + sigma * noise.to(images))


def gaussian_blur(images: Tensor, percent: float, generator: torch.Generator) -> Tensor:
    """Blur by a Gaussian whose standard deviation is `percent` of the shorter side."""
    side = min(images.shape[-2:])
    sigma = percent / 100 * side
    half = min(max(1, round(4 * sigma)), side - 1)  # reflection needs a longer side
    # a tensor, because kornia puts plain numbers on torch's default device
    return gaussian_blur2d(images, 2 * half + 1, images.new_full((1, 2), sigma))


def jpeg_file(images: Tensor, quality: float, generator: torch.Generator) -> Tensor:
    """Encode with libjpeg, and decode."""
    return jpeg(images, images.new_full((len(images),), quality))


def contrast(images: Tensor, factor: float, generator: torch.Generator) -> Tensor:
    """Scale the distances of codes from the image's mean grey by `factor`."""
    return clip(adjust_contrast_with_mean_subtraction(images, factor))


# name to the function, and its amounts: a mild one and a strong one
CORRUPTIONS: dict[str, tuple[Callable[[Tensor, float, torch.Generator], Tensor], list[float]]] = {
    "gaussian_noise": (gaussian_noise, [0.04, 0.1]),
    "gaussian_blur": (gaussian_blur, [1, 3]),
    "jpeg": (jpeg_file, [25, 10]),
    "contrast": (contrast, [0.4, 0.15]),
}


@dataclass(frozen=True, kw_only=True)
class Corrupted(Condition):
    """The image, corrupted.

    Args:
        corruption: a key of `CORRUPTIONS`. amount: the argument of its function.
    """

    kind = "corrupted"
    corruption: str
    amount: float

    @property
    def base_name(self) -> str:
        return f"{self.corruption}_{self.amount:g}"

    def show(self, batch: EvalBatch) -> Tensor:
        corrupt, _ = CORRUPTIONS[self.corruption]
        return corrupt(batch.images, self.amount, batch.generator)
