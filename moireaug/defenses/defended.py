"""Defences in a row, and a defence in front of a model."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from moireaug.common.argument_checks import check_callable, check_whole
from moireaug.common.image_checks import check_images
from moireaug.common.networks import is_randomised, rejects_of
from moireaug.defenses.base import Defence, output_of

IMAGES_PER_CALL = 32  # of draws that are classified together: a call of one image costs much more


@dataclass(frozen=True)
class Compose(Defence):
    """Apply defences in order.

    Args:
        defences: a tuple of defences, or of any callables from images to images of the same shape,
            such as a demoiréing network, whose output is clipped to [0, 1]. A randomised one says
            so by an attribute `randomised = True`. An empty tuple is the identity.

    Between two, the images have the dtype they came with. An image that one of them turns into NaN
    comes out as NaN.

    Backward: through each in turn; where an output is clipped, that of the unclipped one.

    Raises:
        TypeError, ValueError: anything but a tuple of callables, which keep the images' shape.
    """

    defences: tuple[Callable[[Tensor], Tensor], ...]

    def __post_init__(self) -> None:
        if not isinstance(self.defences, (tuple, list)):
            raise TypeError(
                f"Compose takes one tuple of defences, Compose((a, b)); got {self.defences!r}."
            )
        for defence in self.defences:
            check_callable("a defence", defence, "images", " Is it DEFENSES[name]()?")
        object.__setattr__(self, "defences", tuple(self.defences))
        randomised = any(map(is_randomised, self.defences))
        object.__setattr__(self, "randomised", randomised)

    @property
    def networks(self) -> tuple[nn.Module, ...]:
        """The modules among the defences, also inside nested defences."""
        networks: list[nn.Module] = []
        for defence in self.defences:
            if isinstance(defence, Defence):
                networks += defence.networks
            elif isinstance(defence, nn.Module):
                networks.append(defence)
        return tuple(networks)

    def __call__(self, images: Tensor) -> Tensor:
        images = check_images(images)
        if not len(images):
            return images.clone()
        return self.apply(images)  # each handles half precision itself

    def apply(self, images: Tensor) -> Tensor:
        lost = torch.zeros(len(images), 1, 1, 1, dtype=torch.bool, device=images.device)
        for defence in self.defences:
            out = defence(images) if isinstance(defence, Defence) else output_of(defence, images)
            lost = lost | out.isnan().flatten(1).any(1).view(-1, 1, 1, 1)
            images = torch.where(lost, 0, out)  # the next defence would refuse the batch
        return torch.where(lost, math.nan, images)


class Defended(nn.Module):
    """A model behind a defence: logits = model(defence(images)). Attacks on it go through both.

    Args:
        model: [0, 1] images to logits (B, K); a module becomes a submodule, so that its mode and
            device are set here.
        defence: of `moireaug.defenses`, or any callable from images to images, as in `Compose`; a
            module in it becomes a submodule, too.
        draws: number of draws of a random defence or model, one of which says so by an attribute
            `randomised = True` and draws for each image of a batch. With more than one, the logits
            are the logarithm of the predicted probabilities' mean: its gradient is the expectation
            over the draws that an attack needs (EOT; Athalye, Carlini and Wagner 2018). Time and,
            with gradients, memory grow with it. For a random model alone, pass `Compose(())`.

    Raises:
        TypeError, ValueError: a part that is not callable, draws below 1, or more than one of parts
            of which none is randomised.
    """

    def __init__(
        self, model: Callable[[Tensor], Tensor], defence: Callable[[Tensor], Tensor], draws: int = 1
    ) -> None:
        super().__init__()
        check_whole("draws", draws, 1)
        check_callable("model", model)
        chain = defence if isinstance(defence, Compose) else Compose((defence,))
        self.model = model
        self.defence = defence if isinstance(defence, Defence) else chain
        self.networks = nn.ModuleList(chain.networks)
        self.draws = draws
        self.rejects = rejects_of(model)
        if draws > 1 and not self.randomised:
            raise ValueError(
                f"draws = {draws} averages over draws of a random model or defence, and neither "
                "has the attribute randomised = True: set it where random numbers are drawn, or "
                "leave draws out."
            )

    @property
    def randomised(self) -> bool:
        """Whether the defence or the model says that it draws random numbers."""
        return self.defence.randomised or is_randomised(self.model)

    def forward(self, images: Tensor) -> Tensor:
        """Return the logits (B, K) of images (B, 3, H, W) float in [0, 1]. Differentiable in
        images."""
        if self.draws == 1:
            return self._logits(images)
        together = max(1, IMAGES_PER_CALL // max(1, len(images)))  # draws that share a call
        log_probabilities = []
        for first in range(0, self.draws, together):
            n = min(together, self.draws - first)
            logits = self._logits(images.repeat(n, 1, 1, 1))
            log_probabilities.append(logits.log_softmax(1).unflatten(0, (n, len(images))))
        drawn = torch.cat(log_probabilities)
        ruled_out = drawn.isneginf().all(0)  # classes, whose slope of NaN would hide all others
        total = drawn.masked_fill(ruled_out, 0).logsumexp(0).masked_fill(ruled_out, -math.inf)
        return total - math.log(self.draws)

    def _logits(self, images: Tensor) -> Tensor:
        return self.model(self.defence(images).clone())  # the model may work in place
