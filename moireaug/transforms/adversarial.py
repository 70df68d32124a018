"""AdversarialMoire: a batch transform that photographs each image with the noise that fools a model most."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, nn

from moireaug.attacks import MoireAttack
from moireaug.attacks.checks import check_labels
from moireaug.scene import Scene
from moireaug.transforms._convert import as_given, as_shown, check_probability


class AdversarialMoire(nn.Module):
    """The adversarial variant of RandomMoire, used like `v2.MixUp`: on a batch, in the training step or a collate.

        adversarial = AdversarialMoire(model, scene="screen_photo", eps=4 / 255, steps=5)
        images, labels = adversarial(images, labels)
        loader = DataLoader(data, collate_fn=lambda batch: adversarial(*default_collate(batch)))

    Args:
        model: [0, 1] images to logits; only read: its mode, statistics and gradients stay as they are. Not a submodule.
        scene: a Scene, a preset's name or a dict; one shot is drawn per image.
        eps, steps, step_size, loss, random_start: as in `attacks.Attack`. `steps=1, random_start=2, step_size=1` is
            N-FGSM (de Jorge et al., 2022).
        p: share of the images that are photographed; the others pass unchanged.

    Shapes: images (B, C, H, W), C = 3 or 1 (grey), float in [0, 1] or uint8, of which the dtype is kept, and labels
    (B,) int64; both are returned, the labels as they came. Errors as in `attacks.MoireAttack`.
    """

    def __init__(
        self,
        model: nn.Module | Callable[[Tensor], Tensor],
        scene: Scene | str | dict = "screen_photo",
        *,
        eps: float = 4 / 255,
        steps: int = 5,
        step_size: float | None = None,
        loss: str = "ce",
        random_start: float = 1.0,
        p: float = 1.0,
    ) -> None:
        super().__init__()
        if isinstance(eps, (list, tuple)):
            raise ValueError(f"eps must be one number here; got {eps!r}.")
        self.p = check_probability(p)
        self.attack = MoireAttack(
            model=model, scene=scene, eps=eps, steps=steps, step_size=step_size, loss=loss, random_start=random_start
        )

    def forward(
        self, images: Tensor, labels: Tensor, generator: torch.Generator | None = None
    ) -> tuple[Tensor, Tensor]:
        classes = check_labels(labels, len(images), "labels").to(images.device)
        chosen = (torch.rand(len(images), generator=generator) < self.p).to(images.device)
        if not chosen.any():
            return images, labels
        given = images[chosen]
        photos = self.attack.last(as_shown(given), classes[chosen], generator=generator)
        return images.masked_scatter(chosen.view(-1, 1, 1, 1), as_given(photos, given)), labels

    def extra_repr(self) -> str:
        a = self.attack
        return f"eps={a.eps}, steps={a.steps}, loss={a.loss!r}, random_start={a.random_start}, p={self.p}"
