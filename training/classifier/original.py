"""The network that a training began with, whose answers it is to keep; and averages of its weights
with the trained ones, which keep most of both (Wortsman et al., 2022)."""

import copy
from collections.abc import Callable
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.utils.data import DataLoader, Dataset

from moireaug.attacks import predicted

SHARES = (1.0, 0.8, 0.6, 0.4, 0.2)  # of the new weights, tried in this order
BATCH = 32  # images


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


def blended(old: dict[str, Tensor], new: dict[str, Tensor], share: float) -> dict[str, Tensor]:
    """Return the weights between two states of a network; counters stay as in the new one.

    Args:
        share: that of the new weights, in [0, 1].
    """
    between = {}
    for name, weight in new.items():
        if weight.is_floating_point():
            weight = torch.lerp(old[name].to(weight), weight, share)
        between[name] = weight
    return between


class Blend(NamedTuple):
    """Weights between the original's and the trained ones.

    Args:
        new_share: share of the trained weights, one of `SHARES`.
        equal_answers: share of images that are answered as the original does, in [0, 1].
    """

    new_share: float
    equal_answers: float


def keep_answers(model: nn.Module, original: Original, images: Dataset, kept: float) -> Blend:
    """Move a trained model's weights towards the original's, as little as it takes to answer a
    share of images as the original does.

    Args:
        images: images (3, H, W) uint8 with labels, which are not used.
        kept: least share of equal answers, in [0, 1]. Where no average of the weights has it, the
            last of `SHARES` is taken.
    """
    old, new = original.model.state_dict(), copy.deepcopy(model.state_dict())
    device, training = next(model.parameters()).device, model.training
    wanted = _answers(original.logits, images, device)
    model.eval()
    for share in SHARES:
        model.load_state_dict(blended(old, new, share))
        answers = _answers(model, images, device)
        equal_answers = (answers == wanted).double().mean().item()
        if equal_answers >= kept:
            break
    model.train(training)
    return Blend(share, equal_answers)


@torch.no_grad()
def _answers(logits: Callable[[Tensor], Tensor], images: Dataset, device: torch.device) -> Tensor:
    """Return the answers (N,) to all images."""
    batches = DataLoader(images, BATCH)
    return torch.cat([predicted(logits(codes.to(device).float() / 255)) for codes, _ in batches])
