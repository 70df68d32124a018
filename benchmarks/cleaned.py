"""Does a small network, trained on a scene's pairs alone, bring real photos closer to their
originals?"""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.utils.data import DataLoader

from moireaug import Scene
from moireaug.synthesis import Pairs
from moireaug.synthesis.tone import ColourMap, psnr
from training.data.real_pairs import ScreenPhoto

TARGETS = ("twin", "original")
MULTIPLE = 16  # pixels: the network halves a picture four times


@dataclass(frozen=True)
class Effort:
    """How the networks are trained."""

    steps: int = 1500
    batch: int = 8
    side: int = 128  # pixels of the pairs
    rate: float = 1e-3  # at its highest; at twice that, networks die
    shown: int = 768  # pixels a side of the real photos that are cleaned, their middle


class Cleaner(nn.Module):
    """A U-Net (Ronneberger, Fischer and Brox, 2015) of four scales on 2 x 2 pixels at a time, which
    predicts a correction to add to a photo; 0.24 M parameters."""

    def __init__(self, width: int = 24) -> None:
        super().__init__()
        widths = (width, width, 2 * width, 3 * width)
        self.first = nn.Conv2d(12, width, 3, padding=1)
        self.down, self.up = nn.ModuleList(), nn.ModuleList()
        before = width
        for channels in widths:
            self.down.append(_convolved(before, channels))
            before = channels
        for channels in widths[-2::-1]:
            self.up.append(_convolved(before + channels, channels))
            before = channels
        self.last = nn.Conv2d(before, 12, 3, padding=1)
        nn.init.zeros_(self.last.weight)  # an untrained network changes nothing
        nn.init.zeros_(self.last.bias)

    def forward(self, photos: Tensor) -> Tensor:
        """Return photos (B, 3, H, W) in [0, 1], cleaned; H and W are multiples of 16."""
        x = self.first(F.pixel_unshuffle(photos, 2))
        scales = []
        for i, block in enumerate(self.down):
            x = block(F.avg_pool2d(x, 2) if i else x)
            scales.append(x)
        for block, scale in zip(self.up, reversed(scales[:-1]), strict=True):
            x = block(torch.cat([F.interpolate(x, scale_factor=2.0), scale], 1))
        return photos + F.pixel_shuffle(self.last(x), 2)


def _convolved(before: int, after: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(before, after, 3, padding=1),
        nn.GELU(),
        nn.Conv2d(after, after, 3, padding=1),
        nn.GELU(),
    )


def train(scene: Scene, images: Path, target: str, effort: Effort, seed: int = 0) -> Cleaner:
    """Train a network on a scene's pairs.

    Args:
        images: a folder of clean pictures.
        target: "original", or "twin", the same photo without moiré.
    """
    pairs = Pairs(images, scene, effort.side, twin=target == "twin", seed=seed)
    batches = iter(DataLoader(pairs, effort.batch))
    torch.manual_seed(seed)
    network = Cleaner().to(memory_format=torch.channels_last)
    optimiser = torch.optim.AdamW(network.parameters(), effort.rate)
    steps = max(10, effort.steps)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, effort.rate, steps)
    began = time.perf_counter()
    for step in range(effort.steps):
        batch = next(batches)
        photos = batch["photo"].to(memory_format=torch.channels_last)
        before = (photos - batch[target]).abs().mean()
        loss = (network(photos) - batch[target]).abs().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
        if step % 250 == 0:
            seconds = time.perf_counter() - began
            change = f"loss {loss.item():.4f}, of the photos {before.item():.4f}"
            print(f"  step {step}, {change}, {seconds:.0f} s", flush=True)
    return network.eval()


@torch.no_grad()
def cleaned(
    network: nn.Module, pairs: Iterable[ScreenPhoto], shown: int
) -> list[dict[str, float | str]]:
    """Return a row for every real pair: PSNR in dB of the photo before and after the network, raw
    and after the best global colour map onto the original, fitted to each of the two."""
    rows: list[dict[str, float | str]] = []
    for name, photo, original in pairs:
        before, wanted = _middle(photo, shown), _middle(original, shown)  # type: ignore[arg-type]
        after = 255 * network(before[None] / 255)[0].clamp(0, 1)
        row: dict[str, float | str] = {"picture": name}
        for when, picture in (("before", before), ("after", after)):
            codes, aim = picture.contiguous().numpy(), wanted.numpy()
            row[when] = psnr(codes, aim)
            row[f"{when}_mapped"] = psnr(ColourMap.fit(codes, aim)(codes), aim)
        rows.append(row)
    return rows


def _middle(picture: Tensor, side: int) -> Tensor:
    height, width = (min(n, side) // MULTIPLE * MULTIPLE for n in picture.shape[1:])
    top, left = (picture.shape[1] - height) // 2, (picture.shape[2] - width) // 2
    return picture[:, top : top + height, left : left + width].float()


def mean(rows: list[dict[str, float | str]]) -> dict[str, float]:
    """Return the mean of every figure over the pictures."""
    names = [name for name in rows[0] if name != "picture"]
    return {name: float(np.mean([row[name] for row in rows])) for name in names}
