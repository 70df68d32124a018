"""Can a small network tell real photos of screens from simulated ones of the same crops?"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from training.calibration.compare import Crops
from training.comparison.intervals import t_interval

DETAIL_SIGMAS = (3,)  # sigmas, pixels


@dataclass(frozen=True)
class Effort:
    """How the discriminators are trained."""

    steps: int = 200
    batch: int = 32
    side: int = 96  # pixels of the patches that are judged
    judged: int = 256  # patches of the pictures that were left out, half of them real
    rate: float = 4e-3
    folds: int = 6  # at most, of the pictures; one fold is left out at a time


def discriminator(width: int = 16) -> nn.Sequential:
    """Return a network of three strided convolutions and a mean over the patch, of 26 k
    parameters."""
    channels, kernels = (3 + 3 * len(DETAIL_SIGMAS), width, 2 * width, 4 * width), (5, 3, 3)
    layers: list[nn.Module] = []
    for i, kernel in enumerate(kernels):
        conv = nn.Conv2d(channels[i], channels[i + 1], kernel, stride=2, padding=kernel // 2)
        layers += [conv, nn.BatchNorm2d(channels[i + 1]), nn.ReLU()]
    layers += [nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Linear(channels[-1], 1)]
    return nn.Sequential(*layers).to(memory_format=torch.channels_last)


def accuracy_of_telling(
    real: Tensor, simulated: Tensor, crops: Crops, effort: Effort
) -> list[float]:
    """Train a discriminator without one fold of the pictures, and return its accuracy on patches
    of that fold, fold by fold.

    Args:
        real: (N, 3, S, S) uint8. simulated: (K, N, 3, S, S) uint8, K shots of the same crops.
        crops: what these are crops of.
    """
    real, simulated = with_detail(real), torch.stack([with_detail(shot) for shot in simulated])
    folds = min(effort.folds, len(crops.names))
    found = []
    for fold in range(folds):
        left_out = crops.picture % folds == fold
        train, test = (~left_out).nonzero().flatten(), left_out.nonzero().flatten()
        found.append(_leave_out(real, simulated, train, test, effort, seed=fold))
    return found


def _leave_out(
    real: Tensor, simulated: Tensor, train: Tensor, test: Tensor, effort: Effort, seed: int
) -> float:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = discriminator()
        optimiser = torch.optim.AdamW(network.parameters(), effort.rate)
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            optimiser, effort.rate, max(10, effort.steps)
        )
        for _ in range(effort.steps):
            patches, is_real = _patches(real, simulated, train, effort.batch, effort.side)
            loss = F.binary_cross_entropy_with_logits(network(patches).flatten(), is_real)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
        network.eval()
        patches, is_real = _patches(real, simulated, test, effort.judged, effort.side)
        with torch.no_grad():
            right = (network(patches).flatten() > 0) == (is_real > 0.5)
        return right.float().mean().item()


def _patches(
    real: Tensor, simulated: Tensor, rows: Tensor, n: int, side: int
) -> tuple[Tensor, Tensor]:
    """Draw n patches, half of them real, turned and mirrored at random: (n, 3, side, side), and
    which are real, (n,)."""
    is_real = torch.arange(n) % 2
    patches = []
    for kind in is_real.tolist():
        row = int(rows[torch.randint(len(rows), ())])
        picture = real[row] if kind else simulated[torch.randint(len(simulated), ()), row]
        y, x = (int(torch.randint(length - side + 1, ())) for length in picture.shape[-2:])
        patch = picture[:, y : y + side, x : x + side]
        patch = patch.rot90(int(torch.randint(4, ())), (1, 2))
        patches.append(patch.flip(-1) if torch.rand(()) < 0.5 else patch)
    batch = torch.stack(patches).to(memory_format=torch.channels_last)
    return batch.float() / 127.5 - 1, is_real.float()


def with_detail(photos: Tensor) -> Tensor:
    """Return photos (N, 3, S, S) uint8 with their detail beside their colours, (N, 6, S, S) uint8.

    Detail is what a Gaussian blur of 3 pixels takes away, ten times as strong, as moiré of two
    codes is nothing beside an edge of a hundred.
    """
    found = []
    for photo in photos:
        codes = photo.permute(1, 2, 0).float().numpy()
        layers = [photo]
        for sigma in DETAIL_SIGMAS:
            detail = np.tanh((codes - cv2.GaussianBlur(codes, (0, 0), sigma)) * (10 / 127.5))
            as_codes = torch.from_numpy(127.5 * (1 + detail)).round().to(torch.uint8)
            layers.append(as_codes.permute(2, 0, 1))
        found.append(torch.cat(layers))
    return torch.stack(found)


def summarised(accuracies: list[float]) -> dict[str, float]:
    """Return the mean over the folds and its 95 % interval."""
    low, high = t_interval(accuracies)
    return {"accuracy": sum(accuracies) / len(accuracies), "low": low, "high": min(1.0, high)}
