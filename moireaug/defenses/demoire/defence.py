"""A demoiréing network as a defence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from torch import Tensor, nn

from moireaug.common.argument_checks import check_callable
from moireaug.common.networks import first_weight
from moireaug.defenses.base import Defence, output_of


@dataclass(frozen=True)
class Demoire(Defence):
    """A demoiréing network before the model.

    Args:
        network: from `demoire.build` or `demoire.load`, or any callable from images (B, 3, H, W) in
            [0, 1] to images of the same shape, clipped here. A module is called in the mode that it
            is in; attacks and `evaluate` put it into evaluation, as they do the model. Images are
            computed in the dtype of its parameters. A randomised one says so by an attribute
            `randomised = True`.

    Backward: the network's own gradient; where its output is clipped, that of the unclipped one.

    Raises:
        TypeError: a network that cannot be called on images.
        ValueError: in a call, a network that changes the images' shape.
    """

    network: Callable[[Tensor], Tensor]

    def __post_init__(self) -> None:
        check_callable("network", self.network, "images", " Is it demoire.load(FILE)?")
        randomised = bool(getattr(self.network, "randomised", False))
        object.__setattr__(self, "randomised", randomised)

    @property
    def networks(self) -> tuple[nn.Module, ...]:
        return (self.network,) if isinstance(self.network, nn.Module) else ()

    def apply(self, images: Tensor) -> Tensor:
        weight = first_weight(*self.networks)
        x = images if weight is None else images.to(weight.dtype)
        return output_of(self.network, x).to(images.dtype)
