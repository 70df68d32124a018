"""The base of every demoiréing network, and the defence made of one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

from torch import Tensor, nn

from moireaug.common.argument_checks import check_callable, check_real
from moireaug.common.image_checks import check_shape
from moireaug.common.networks import first_weight, is_randomised
from moireaug.common.numeric import mirrored_indices
from moireaug.defenses.base import Defence, output_of, straight_through

MAX_WIDTH = 4.0
CHANNEL_MULTIPLE = 4  # to which numbers of channels are rounded


class DemoireNet(nn.Module, ABC):
    """A demoiréing network: a subclass sets its `name` in `demoire.NETWORKS`, the `multiple` of
    which the sides of the images given to `predict` are, in pixels, and computes that.

    Args:
        width: factor on the published numbers of channels, in (0, 4].

    Raises:
        TypeError, ValueError: a width out of range.
    """

    name: str
    multiple: int

    def __init__(self, width: float = 1.0) -> None:
        super().__init__()
        check_real("width", width, 0, MAX_WIDTH)
        self.width = float(width)

    @abstractmethod
    def predict(self, images: Tensor) -> tuple[Tensor, ...]:
        """Return `outputs` of images whose sides are multiples of `multiple`."""

    def outputs(self, images: Tensor) -> tuple[Tensor, ...]:
        """Predict the images without moiré as the published loss takes them: not clipped.

        Args:
            images: (B, 3, H, W) float in [0, 1], sRGB codes, of any size. Their right and lower
                edges are extended by their mirror image to a multiple of `multiple`, and the
                predictions cropped.

        Returns:
            Predictions from the finest to the coarsest. The first is the image, (B, 3, H, W); the
            others depend on the network: images at the same size or at 1 / s of it, (B, 3, ceil(H
            / s), ceil(W / s)), or edges. Differentiable in images and weights.

        Raises:
            TypeError, ValueError: images of another type or shape.
        """
        check_shape(images)
        if not len(images):
            raise ValueError(f"images must be one or more; got {tuple(images.shape)}.")
        if not images.is_floating_point():  # values stay unchecked: that would wait for a device
            raise TypeError(
                f"images must be floating point in [0, 1]; got {images.dtype}. Divide uint8 images "
                "by 255."
            )
        height, width = images.shape[-2:]
        extended, below, right = images, -height % self.multiple, -width % self.multiple
        if below:
            extended = extended[..., mirrored_indices(height, 0, below, images.device), :]
        if right:
            extended = extended[..., mirrored_indices(width, 0, right, images.device)]
        predictions = self.predict(extended)
        finest = predictions[0].shape[-2]
        cropped = []
        for prediction in predictions:
            scale = finest // prediction.shape[-2]
            rows, columns = -(-height // scale), -(-width // scale)
            cropped.append(prediction[..., :rows, :columns])
        return tuple(cropped)

    def forward(self, images: Tensor) -> Tensor:
        """Remove the moiré.

        Args:
            images: (B, 3, H, W) float in [0, 1], sRGB codes, of any size.

        Returns:
            (B, 3, H, W) in [0, 1]: the finest of `outputs`, clipped. The gradient is that of the
            unclipped prediction, which would otherwise hide from an attack beyond black and white
            (BPDA; Athalye, Carlini and Wagner 2018).

        Raises:
            TypeError, ValueError: as `outputs`.
        """
        finest = self.outputs(images)[0]
        return straight_through(finest, finest.clamp(0, 1))

    def extra_repr(self) -> str:
        return f"width={self.width:g}"


def scaled(channels: int, width: float) -> int:
    """Return a published number of channels times `width`, rounded to a multiple of
    `CHANNEL_MULTIPLE` and at least that; at width 1 the number itself."""
    if width == 1:
        return channels
    return CHANNEL_MULTIPLE * max(1, round(channels * width / CHANNEL_MULTIPLE))


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
        TypeError, ValueError: a network that cannot be called, or changes the images' shape.
    """

    network: Callable[[Tensor], Tensor]

    def __post_init__(self) -> None:
        check_callable("network", self.network, "images", " Is it demoire.load(FILE)?")
        object.__setattr__(self, "randomised", is_randomised(self.network))

    @property
    def networks(self) -> tuple[nn.Module, ...]:
        return (self.network,) if isinstance(self.network, nn.Module) else ()

    def apply(self, images: Tensor) -> Tensor:
        weight = first_weight(*self.networks)
        x = images if weight is None else images.to(weight.dtype)
        return output_of(self.network, x).to(images.dtype)
