"""Train a detector of screen photos on simulated ones alone.

    python training/detect.py train images=DIR weights=resnet18.pth

`images` is a folder of ordinary pictures, of any content; without it, they are drawn. Screens that
show them are photographed in the scenes of "anywhere", as crops and as whole screens in rooms;
negatives are the pictures and rooms, the same photos without moiré, and prints, all as JPEG.
`weights` is a state_dict of the backbone, a ResNet of torchvision, or the name of published ones,
such as DEFAULT; its stages stay as they are, and two linear heads on them are fitted. By the
threshold, `false_alarms` of the photos in `ordinary` are called screens, or of a tenth of the
pictures, which are left out of the training. Writes detector.pt and metrics.json into out=DIR."""

import json
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from omegaconf import MISSING
from torch import Tensor
from torch.utils.data import DataLoader
from tqdm import tqdm

from moireaug.common.files import write_text
from moireaug.synthesis.pictures import Pictures, Source
from training.config import scenes
from training.config.commands import parse, report_errors
from training.config.settings import setting
from training.demoireing.pictures import DrawnPictures, split_tenths
from training.detection.examples import PHOTO_SIDE, Examples
from training.detection.measures import auc
from training.detection.network import LOOKS, Detector, as_photo, fit_head
from training.system.files import make_folder

EXAMPLE = "python training/detect.py train images=DIR weights=resnet18.pth"
HELD_OUT_DIVISOR = 10  # a tenth of the rounds is left out of the training
MIN_SIDE = 32  # of pictures that train, pixels
DRAWN_ORDINARY = 100  # pictures that set the threshold where all are drawn
BATCH = 32


@dataclass
class Config:
    """All settings of the command."""

    images: str | None = setting(None, "a folder of ordinary pictures; null: drawn ones")
    ordinary: str | None = setting(
        None, "a folder of photos without screens, to set the threshold; null: a tenth of images"
    )
    scene: str = setting("anywhere", "of the screens: a preset, or a YAML file")
    weights: str | None = setting(MISSING, "of the backbone: a file, a name, or null for random")
    backbone: str = setting("resnet18", "a ResNet of torchvision")
    out: str = setting("runs/detect", "the folder of the results")
    n: int = setting(300, "rounds of about eleven examples", bounds=(4, None))
    penalty: float = setting(0.5, "of the heads' squared weights", bounds=(0, None))
    false_alarms: float = setting(0.1, "share of ordinary photos called screens", bounds=(0, 1))
    seed: int = setting(0, "of the examples", bounds=(0, 2**31))
    workers: int = setting(0, "processes; 0: this one", bounds=(0, None))


def train(cfg: Config) -> dict[str, Any]:
    """Train, write and print; return what metrics.json holds.

    Raises:
        ValueError: no pictures, or weights that do not fit.
        OSError: the disk is full or not writable.
    """
    start = time.perf_counter()
    detector = Detector(cfg.backbone, cfg.weights)
    pictures, ordinary = sources(cfg)
    out = Path(cfg.out)
    make_folder(out, "out=DIR")
    rounds = Examples(pictures, scenes.load(cfg.scene), cfg.seed)
    numbers, workers = range(cfg.n), cfg.workers
    loader = DataLoader(
        rounds, batch_size=None, sampler=numbers, num_workers=workers, collate_fn=list
    )
    seen: dict[str, list[tuple[Tensor, bool, int]]] = {look: [] for look in LOOKS}
    kinds: Counter[str] = Counter()
    for number, examples in enumerate(tqdm(loader, unit="round", disable=None)):
        for look in LOOKS:
            of_look = [example for example in examples if example.look == look]
            features = features_of(detector, [example.image for example in of_look])
            for row, example in zip(features, of_look, strict=True):
                seen[look].append((row, example.is_screen, number))
                kinds[f"{look}: {example.kind}"] += 1
    metrics: dict[str, Any] = {"settings": vars(cfg), "examples": dict(kinds), "auc": {}}
    held_out = range(0, cfg.n, HELD_OUT_DIVISOR)
    for look in LOOKS:
        x = torch.stack([row for row, _, _ in seen[look]])
        truth = torch.tensor([is_screen for _, is_screen, _ in seen[look]])
        tests = torch.tensor([number in held_out for _, _, number in seen[look]])
        fit_head(detector.heads[look], x[~tests], truth[~tests].tolist(), cfg.penalty)
        with torch.no_grad():
            logits = detector.heads[look](x[tests])[:, 0].numpy()
        is_screen = truth[tests].numpy()
        metrics["auc"][look] = auc(logits[is_screen], logits[~is_screen])
    scores = torch.tensor([score_of(detector, picture) for picture in ordinary])
    detector.threshold.fill_(float(torch.quantile(scores, 1 - cfg.false_alarms)))
    metrics["threshold"] = detector.threshold.item()
    metrics["seconds"] = time.perf_counter() - start
    detector.save(out / "detector.pt")
    write_text(out / "metrics.json", json.dumps(metrics, indent=1))
    found = ", ".join(f"{look} {area:.3f}" for look, area in metrics["auc"].items())
    print(f"AUC on simulated photos that were left out: {found}")
    print(f"Written in {metrics['seconds']:.0f} s: {out / 'detector.pt'}")
    return metrics


def sources(cfg: Config) -> tuple[Source, list[Any]]:
    """Return the pictures that train, and the ordinary photos that set the threshold."""
    rng = np.random.default_rng((cfg.seed, 1))
    pictures: Source = DrawnPictures(PHOTO_SIDE)
    if cfg.images is None:
        others = [pictures.draw(rng)[1] for _ in range(DRAWN_ORDINARY)]
    else:
        pictures, held_out = split_tenths(Pictures(cfg.images, MIN_SIDE), 2)
        others = readable(held_out)
    if cfg.ordinary is not None:
        others = readable(Pictures(cfg.ordinary, 1))
    return pictures, others


def readable(pictures: Pictures) -> list[Any]:
    """Return the usable ones among pictures.

    Raises:
        NoPictureError: none is usable.
    """
    found = []
    for number in range(len(pictures)):
        try:
            found.append(pictures.subset([number]).draw(np.random.default_rng(0))[1])
        except ValueError as error:
            reason = error
    if not found:
        raise reason
    return found


@torch.no_grad()
def features_of(detector: Detector, images: Sequence[Tensor]) -> Tensor:
    """Return the features of images (3, side, side) uint8, batch by batch."""
    found = []
    for first in range(0, len(images), BATCH):
        batch = torch.stack(list(images[first : first + BATCH])).float() / 255
        found.append(detector.features(batch))
    return torch.cat(found)


@torch.no_grad()
def score_of(detector: Detector, picture: Any) -> float:
    """Return the score of a PIL picture."""
    return detector(as_photo(picture)).item()


configure = partial(parse, schema=Config, example=EXAMPLE, description=__doc__)


def main(argv: Sequence[str]) -> None:
    """Run the command line, or exit with a one-line error."""
    with report_errors("Interrupted before the detector was written."):
        train(configure(argv))
