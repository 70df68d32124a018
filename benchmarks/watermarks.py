"""Is a watermark read from a photo of a screen? One small encoder and decoder, of 64 bits in images
of 128 px, trained with no layer between them, with crop, blur and JPEG, with a layer as PIMoG
describes it, and with ScreenCamera; each is read through each of these layers and in photos in
every preset of "anywhere", half of which no training has seen. All start from one training without
a layer, and all marks have the same PSNR, 36 dB at first, and 40 after further training.

    python benchmarks/watermarks.py --photos DIR     # minutes of one core; results/watermarks.csv
    python benchmarks/watermarks.py --quick

Half of the pictures are drawn, the others crops of those in DIR, at any depth, of which every fifth
is kept for reading; without DIR all are drawn. Weights are kept in --runs: the same command
continues there after the last layer that was trained.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import torch
import torch.nn.functional as F
from PIL import Image, ImageOps
from torch import Tensor, nn

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

from benchmarks import measure
from benchmarks.watermark_networks import (
    BITS,
    JITTER,
    SIDE,
    CropBlurJpeg,
    Decoder,
    Encoder,
    PimogLike,
)
from moireaug.mixtures import as_scenes, scenes_of
from moireaug.nn import ScreenCamera
from moireaug.scene.presets import MIXTURES
from training.data.drawn_pictures import render

TRAINED_PRESETS = (
    "screen_photo",
    "phone_at_monitor",
    "phone_at_phone",
    "phone_at_television",
    "phone_close_to_lcd",
    "document_camera_at_tablet",
    "webcam_at_phone",
)
SHRINK = (1.0, 3.0)  # of crops; the other half of photos shows whole pictures
BATCH = 8
SOURCE_SIDE = 256  # pixels of the pictures that images are cut from


class Stage(NamedTuple):
    """A part of a training, after which the marks are read.

    Args:
        steps: steps of the optimizer.
        start, psnr: PSNR of the marks at first, and from half of the steps on, in dB.
        rate: highest rate of learning.
    """

    steps: int
    start: float
    psnr: float
    rate: float


@dataclass(frozen=True)
class Sizes:
    """How long is trained, first without a layer and then with each, and what is read."""

    start: Stage = Stage(4000, 20.0, 36.0, 2e-3)
    stages: tuple[Stage, ...] = (Stage(1500, 32.0, 36.0, 1e-3), Stage(1000, 36.0, 40.0, 1e-3))
    pictures: int = 150  # drawn ones, for training
    test_pictures: int = 40  # of each kind, drawn or photographed
    presets: tuple[str, ...] = MIXTURES["anywhere"]
    seed: int = 0


QUICK_SETTINGS = Sizes(
    Stage(3, 20.0, 36.0, 2e-3),
    (Stage(2, 36.0, 36.0, 1e-3),),
    pictures=4,
    test_pictures=2,
    presets=("screen_photo", "phone_at_laptop"),
)


def photos_of_screens(presets: tuple[str, ...]) -> ScreenCamera:
    """Return the layer of whole photos and crops, as many of each, in presets."""
    scenes = []
    for preset in presets:
        for shrink in (None, SHRINK):
            scenes += scenes_of(as_scenes(preset, shrink))
    return ScreenCamera(scenes, jitter=JITTER)


def layers() -> dict[str, nn.Module]:
    """Return the layers to train with."""
    return {
        "no layer": nn.Identity(),
        "crop, blur, JPEG": CropBlurJpeg(),
        "as PIMoG's": PimogLike(),
        "ScreenCamera": photos_of_screens(TRAINED_PRESETS),
    }


def drawn(seed: int, n: int) -> Tensor:
    """Return n drawn pictures, (n, 3, SOURCE_SIDE, SOURCE_SIDE) uint8."""
    pictures = []
    for k in range(n):
        _, picture = render(np.random.default_rng([seed, k]), SOURCE_SIDE)
        pictures.append(np.array(picture))
    return torch.from_numpy(np.stack(pictures)).permute(0, 3, 1, 2)


def photographed(folder: Path | None) -> Tensor:
    """Return the middles of a folder's pictures, (n, 3, SOURCE_SIDE, SOURCE_SIDE) uint8."""
    pictures = []
    names = [] if folder is None else sorted(folder.rglob("*"))
    for name in names:
        if name.suffix.lower() in (".jpg", ".jpeg", ".png"):
            picture = Image.open(name).convert("RGB")
            pictures.append(np.array(ImageOps.fit(picture, (SOURCE_SIDE, SOURCE_SIDE))))
    if not pictures:
        return torch.empty(0, 3, SOURCE_SIDE, SOURCE_SIDE, dtype=torch.uint8)
    return torch.from_numpy(np.stack(pictures)).permute(0, 3, 1, 2)


def cut(pictures: Tensor, n: int) -> Tensor:
    """Return n random crops of pictures, (n, 3, SIDE, SIDE) in [0, 1]."""
    crops = []
    for k in torch.randint(len(pictures), (n,)).tolist():
        top, left = torch.randint(SOURCE_SIDE - SIDE + 1, (2,)).tolist()
        crops.append(pictures[k, :, top : top + SIDE, left : left + SIDE])
    return torch.stack(crops).float() / 255


def train(networks: nn.ModuleList, layer: nn.Module, pools: list[Tensor], stage: Stage) -> None:
    """Train an encoder and a decoder with a layer between them for one stage."""
    encoder, decoder = networks.train()
    optimizer = torch.optim.Adam(networks.parameters())
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, stage.rate, total_steps=stage.steps + 1, pct_start=0.04
    )
    for step in range(stage.steps):
        left = max(0.0, 1 - 2 * step / stage.steps)
        psnr = stage.psnr - left * (stage.psnr - stage.start)
        images = torch.cat([cut(pool, BATCH // len(pools)) for pool in pools])
        bits = torch.randint(0, 2, (BATCH, BITS)).float()
        photos = layer(encoder(images, bits, psnr))
        loss = F.binary_cross_entropy_with_logits(decoder(photos), bits)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        if step % 200 == 0:
            print(f"  step {step}, {psnr:.0f} dB, loss {loss.item():.3f}", flush=True)


@torch.no_grad()
def read(networks: nn.ModuleList, images: Tensor, stage: Stage, sizes: Sizes) -> list[dict]:
    """Return the bit errors of marked images in each layer and preset, and the marks' PSNR."""
    encoder, decoder = networks.eval()
    torch.manual_seed(1)
    bits = torch.randint(0, 2, (len(images), BITS)).float()
    marked = (encoder(images, bits, stage.psnr) * 255).round() / 255
    psnr = -10 * (marked - images).square().mean((1, 2, 3)).log10().mean()
    coarse = share_of_coarse_waves(marked - images)
    channels = {name: layer for name, layer in layers().items() if name != "ScreenCamera"}
    for preset in sizes.presets:
        channels[preset] = photos_of_screens((preset,))
    rows = []
    for name, layer in channels.items():
        torch.manual_seed(2)
        errors = ((decoder(layer(marked)) > 0) != bits).float().mean(1)
        kind = "layer"
        if name in sizes.presets:
            kind = "seen preset" if name in TRAINED_PRESETS else "unseen preset"
        row = {
            "stage": stage.psnr,
            "read through": name,
            "kind": kind,
            "psnr": float(psnr),
            "coarse": coarse,
        }
        row["n"] = len(images)
        rows.append(row | {"bit errors": float(errors.mean()), "std": float(errors.std())})
    return rows


def share_of_coarse_waves(marks: Tensor) -> float:
    """Return the share of marks' power in waves longer than 20 pixels."""
    power = torch.fft.fft2(marks).abs().square().mean((0, 1))
    frequency = torch.fft.fftfreq(SIDE)
    is_coarse = torch.hypot(frequency[:, None], frequency) < 1 / 20
    return float(power[is_coarse].sum() / power.sum())


def train_or_load(
    networks: nn.ModuleList, name: str, pools: list[Tensor], stage: Stage, runs: Path, seed: int
) -> None:
    """Train networks with the layer of a name for one stage, or take that stage's from its file."""
    path = runs / f"{name.replace(' ', '_')}-{stage.steps}-{stage.psnr:g}-{seed}.pt"
    torch.manual_seed(seed)  # each layer meets the same images
    if path.exists():
        networks.load_state_dict(torch.load(path, weights_only=True))
        return
    began = time.process_time()
    print(f"training with {name}, to {stage.psnr:g} dB", flush=True)
    train(networks, layers()[name], pools, stage)
    print(f"  {(time.process_time() - began) / stage.steps:.3f} s of the cores a step", flush=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save(networks.state_dict(), path)


def main() -> None:
    """Train, read, publish."""
    parser = measure.arguments(__doc__ or "")
    parser.add_argument("--photos", type=Path, help="folder of pictures; none are all drawn")
    parser.add_argument("--runs", type=Path, help="folder of the weights; in that of the results")
    args, sizes, _ = measure.begin(parser, Sizes(), QUICK_SETTINGS)
    folder = measure.results(args)
    table = pd.DataFrame(rows_of(args, sizes, args.runs or folder / "watermarks"))
    measure.publish(table, folder / "watermarks.csv")
    print(measure.text_of(matrix(table)))


def rows_of(args: argparse.Namespace, sizes: Sizes, runs: Path) -> list[dict]:
    """Return the bit errors of each network in each layer and preset."""
    photos = photographed(args.photos)
    is_test = torch.arange(len(photos)) % 5 == 4
    pools = [drawn(0, sizes.pictures), photos[~is_test]]
    pools = [pool for pool in pools if len(pool)]
    test_pools = [drawn(1, sizes.test_pictures), photos[is_test][: sizes.test_pictures]]
    torch.manual_seed(0)
    images = torch.cat([cut(pool, sizes.test_pictures) for pool in test_pools if len(pool)])
    rows = []
    for name in layers():
        torch.manual_seed(sizes.seed)
        networks = nn.ModuleList([Encoder(), Decoder()])
        train_or_load(networks, "no layer", pools, sizes.start, runs, sizes.seed)
        for stage in sizes.stages:
            train_or_load(networks, name, pools, stage, runs, sizes.seed)
            facts = {"trained with": name, "seed": sizes.seed}
            rows += [facts | row for row in read(networks, images, stage, sizes)]
    return rows


def matrix(table: pd.DataFrame) -> pd.DataFrame:
    """Return bit errors in % by training and channel, means over presets that were seen and not."""
    is_layer = table["kind"] == "layer"
    channels = table["read through"].where(is_layer, table["kind"])
    means = table.assign(channel=channels).pivot_table(
        "bit errors", ["stage", "trained with"], "channel", sort=False
    )
    return (100 * means).round(1).reset_index()


if __name__ == "__main__":
    main()
