"""The base of every demoiréing network: images of any size in, images in [0, 1] out."""

from __future__ import annotations

from abc import ABC, abstractmethod

from torch import Tensor, nn

from moireaug.common.argument_checks import check_real
from moireaug.common.image_checks import check_shape
from moireaug.common.numeric import mirrored_indices
from moireaug.defenses.base import straight_through

MAX_WIDTH = 4.0
CHANNEL_MULTIPLE = 4  # to which numbers of channels are rounded


class DemoireNet(nn.Module, ABC):
    """A demoiréing network: a subclass sets `name` and `multiple`, and computes `predict`.

    Args:
        width: factor on the published numbers of channels, in (0, 4].

    Attributes:
        name: of `demoire.NETWORKS`.
        multiple: the sides of the images given to `predict` are multiples of this, in pixels.

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
        """Predict from images whose sides are multiples of `multiple`: `outputs` without its
        crop."""

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
        _check_images(images)
        height, width = images.shape[-2:]
        predictions = self.predict(self._extended(images))
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
            unclipped prediction: a network whose output goes beyond black or white would otherwise
            have none there, and hide from an attack (BPDA; Athalye, Carlini and Wagner 2018).

        Raises:
            TypeError, ValueError: as `outputs`.
        """
        finest = self.outputs(images)[0]
        return straight_through(finest, finest.clamp(0, 1))

    def extra_repr(self) -> str:
        return f"width={self.width:g}"

    def _extended(self, images: Tensor) -> Tensor:
        """Extend the right and lower edges to a multiple of `multiple`."""
        height, width = images.shape[-2:]
        if height % self.multiple:
            rows = mirrored_indices(height, 0, -height % self.multiple, images.device)
            images = images[..., rows, :]
        if width % self.multiple:
            columns = mirrored_indices(width, 0, -width % self.multiple, images.device)
            images = images[..., columns]
        return images


def scaled(channels: int, width: float) -> int:
    """Return a published number of channels times `width`, rounded to a multiple of
    `CHANNEL_MULTIPLE` and at least that; at width 1 the number itself."""
    if width == 1:
        return channels
    return CHANNEL_MULTIPLE * max(1, round(channels * width / CHANNEL_MULTIPLE))


def _check_images(images: Tensor) -> None:
    """Refuse anything but a float batch of three channels; values are not checked, which would wait
    for the device in every training step."""
    check_shape(images)
    if not len(images):
        raise ValueError(f"images must be one or more; got {tuple(images.shape)}.")
    if not images.is_floating_point():
        raise TypeError(
            f"images must be floating point in [0, 1]; got {images.dtype}. Divide uint8 images by "
            "255."
        )
