"""The detector's linear heads, one for each look at a photo: their fit, and their common score."""

from collections.abc import Mapping, Sequence

import torch
import torch.nn.functional as F
from torch import Tensor, nn

LOOKS = ("crop", "whole")
Part = tuple[Tensor, Tensor]  # of examples: features (N, F), and whether each is a screen (N,)
Parts = Mapping[str, Sequence[Part]]  # by look


class Heads(nn.Module):
    """Weigh what a network sees of photos.

    Args:
        width: of the features, F.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.crop, self.whole = nn.Linear(width, 1), nn.Linear(width, 1)

    def forward(self, crops: Tensor, wholes: Tensor) -> Tensor:
        """Return the scores (B,) of photos, of the features of their crops (B, crops, F) and of the
        whole ones (B, F): the crops' mean and maximum and the whole photo's, added up."""
        logits = self.crop(crops)[..., 0]
        return logits.mean(1) + logits.amax(1) + self.whole(wholes)[:, 0]

    def fit(self, parts: Parts, penalty: float) -> None:
        """Fit each look's head to its parts, see `fit_head`."""
        for look in LOOKS:
            fit_head(self.get_submodule(look), parts[look], penalty)


@torch.enable_grad()
def fit_head(head: nn.Module, parts: Sequence[Part], penalty: float) -> None:
    """Fit a head by logistic regression. All parts weigh the same, and in each its screens and its
    others.

    Args:
        head: nn.Linear(F, 1). parts: of the examples: features (N, F), and whether each is a screen
            (N,).
        penalty: of the squared weights of standardised features, per example.
    """
    features = torch.cat([seen for seen, _ in parts]).double()
    truth = torch.cat([is_screen for _, is_screen in parts]).double()
    balance = torch.cat([_weights(is_screen) for _, is_screen in parts]) / len(parts)
    mean, std = features.mean(0), features.std(0) + 1e-6
    rows = (features - mean) / std
    slope = torch.zeros(rows.shape[1], dtype=torch.float64, requires_grad=True)
    bias = torch.zeros((), dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.LBFGS([slope, bias], max_iter=200, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        optimiser.zero_grad()
        logits = rows @ slope + bias
        total = F.binary_cross_entropy_with_logits(logits, truth, balance, reduction="sum")
        total = total + penalty / 2 * slope.square().sum()
        total.backward()
        return total

    optimiser.step(loss)
    weight = (slope / std).detach()
    state = {"weight": weight[None], "bias": (bias - weight @ mean).detach()[None]}
    head.load_state_dict(state)


def _weights(is_screen: Tensor) -> Tensor:
    """Return the weights (N,) of examples: 1 in all, half of it that of screens."""
    share = is_screen.double().mean()
    return torch.where(is_screen, 0.5 / share, 0.5 / (1 - share)) / len(is_screen)
