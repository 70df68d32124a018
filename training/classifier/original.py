"""The network that a training began with, whose answers it is to keep."""

import copy

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from moireaug.attacks import predicted


class Original:
    """A frozen copy of a network; no module, so that it is neither trained, averaged nor saved.

    Args:
        model: classifier of [0, 1] images (B, 3, H, W), which returns logits (B, classes).
    """

    def __init__(self, model: nn.Module) -> None:
        self.model = copy.deepcopy(model).eval().requires_grad_(False)

    @torch.no_grad()
    def logits(self, images: Tensor) -> Tensor:
        """Return its logits of images, on their device."""
        return self.model.to(images.device)(images)

    def answers(self, images: Tensor) -> Tensor:
        """Return its answers (B,) to images, as labels."""
        return predicted(self.logits(images))


def divergence(logits: Tensor, wanted: Tensor) -> Tensor:
    """Return the mean Kullback-Leibler divergence of answers from the wanted ones, both as logits
    (B, classes); differentiable in the first (Hinton et al., 2015)."""
    log_probabilities = (logits.float().log_softmax(1), wanted.float().log_softmax(1))
    return F.kl_div(*log_probabilities, reduction="batchmean", log_target=True)
