"""The attacked model: normalisation inside it, and its state restored after an attack."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterator, Sequence

import torch
from torch import Tensor, nn

# what torch says where weights and images differ in precision, or in device
OTHER_TYPE = r"same dtype|type .* should be the same|expected scalar type"


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
                "mean and std must each be a list of finite numbers, 3 for the channels or 1 for "
                f"all, and every std must be above 0; got mean = {mean}, std = {std}."
            )
        self.model = model
        self.register_buffer("mean", means.view(-1, 1, 1), persistent=False)
        self.register_buffer("std", stds.view(-1, 1, 1), persistent=False)

    def forward(self, images: Tensor) -> Tensor:
        return self.model((images - self.mean.to(images)) / self.std.to(images))


def _said_of_types(weight: Tensor, said: str) -> str:
    """Return a sentence on images that do not meet the model's first weight.

    Args:
        said: by torch, as in "Input type (torch.FloatTensor) and weight type
            (torch.cuda.FloatTensor) should be the same".
    """
    types = re.findall(r"(\w+Tensor)\)", said)
    if len(types) > 1 and len(set(types)) == 1:  # only their devices differ
        device = str(weight.device)
        return (
            f"the model is on {device} and does not take these images ({said}): pass "
            f"images.to({device!r})."
        )
    return (
        f"the model has weights of {weight.dtype} and does not take these images ({said}): pass a "
        f"function that converts them, as in lambda images: model(images.to({weight.dtype}))."
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
            in precision or in device.
    """
    modules = list(model.modules()) if isinstance(model, nn.Module) else []
    # TorchScript's frozen modules have no mode
    modes = [(m, m.training) for m in modules if hasattr(m, "training")]
    try:
        if isinstance(model, nn.Module):
            model.eval()
        with torch.inference_mode(False), torch.enable_grad():
            yield
    except RuntimeError as error:
        weights = model.parameters() if isinstance(model, nn.Module) else iter(())
        weight = next(filter(Tensor.is_floating_point, weights), None)
        if weight is not None and re.search(OTHER_TYPE, str(error)):
            raise TypeError(_said_of_types(weight, str(error).splitlines()[0])) from error
        raise
    finally:
        for module, training in modes:
            module.training = training
