"""The attacked model: normalisation inside it, and its state restored after an attack."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterator, Sequence

import torch
from torch import Tensor, nn

# what torch says where weights and images differ in precision
OTHER_PRECISION = r"same dtype|type .* should be the same|expected scalar type"


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
        sized = means.shape == stds.shape and means.shape in ((1,), (3,))
        if not (sized and means.isfinite().all() and stds.isfinite().all() and (stds > 0).all()):
            raise ValueError(
                "mean and std must each hold one finite number per channel, 3 or 1 for all, and "
                f"every std must be above 0; got mean = {mean}, std = {std}."
            )
        self.model = model
        self.register_buffer("mean", means.view(-1, 1, 1), persistent=False)
        self.register_buffer("std", stds.view(-1, 1, 1), persistent=False)

    def forward(self, images: Tensor) -> Tensor:
        return self.model((images - self.mean) / self.std)


def _said_of_precision(model: nn.Module, error: RuntimeError) -> str:
    dtypes = {value.dtype for value in model.parameters() if value.is_floating_point()}
    weights = " and ".join(sorted(str(dtype).removeprefix("torch.") for dtype in dtypes))
    return (
        f"the model, whose weights are {weights or 'none'}, does not take these images "
        f"({str(error).splitlines()[0]}): pass model.float(), or a function that converts them, as "
        "in lambda images: model(images.half())."
    )


@contextlib.contextmanager
def evaluating(model: nn.Module | Callable[[Tensor], Tensor]) -> Iterator[None]:
    """Put a model into evaluation mode, and restore every module's own mode on exit, also after an
    error.

    BatchNorm would otherwise update its statistics from the attack's intermediate images. Gradients
    are enabled inside, even under `torch.no_grad` and `torch.inference_mode`, because every attack
    needs them.

    Raises:
        TypeError: in place of torch's RuntimeError where the model's weights and the images differ
            in precision.
    """
    modes = [(m, m.training) for m in model.modules()] if isinstance(model, nn.Module) else []
    try:
        if isinstance(model, nn.Module):
            model.eval()
        with torch.inference_mode(False), torch.enable_grad():
            yield
    except RuntimeError as error:
        if isinstance(model, nn.Module) and re.search(OTHER_PRECISION, str(error)):
            raise TypeError(_said_of_precision(model, error)) from error
        raise
    finally:
        for module, training in modes:
            module.training = training
