"""Train a detector of screen photos on simulated ones, and on labelled ones of your own.

    python training/detect.py train images=DIR weights=resnet18.pth

`images` is a folder of ordinary pictures, of any content; without it, they are drawn. Screens that
show them are photographed in the scenes of "anywhere", as crops and as whole screens in rooms;
negatives are the pictures and rooms, the same photos without moiré, and prints, all as JPEG.
`weights` is a state_dict of the backbone, a ResNet of torchvision, or the name of published ones,
such as DEFAULT; its stages stay as they are, and two linear heads on them are fitted. Photos in
`labelled`, in folders whose names start with the word "real" or "screen", weigh as much as all
simulated ones. By the threshold, `false_alarms` of the photos in `ordinary` are called screens; or
of a tenth of the pictures, which are left out of the training, and of the labelled photos that are
no screens, as detectors score them that are fitted without a fifth of the labelled ones. These
scores also tell how well the detector does on photos like them. Writes detector.pt and metrics.json
into out=DIR."""

import json
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from omegaconf import MISSING
from torch import Tensor
from torch.utils.data import DataLoader
from tqdm import tqdm

from moireaug.common.files import write_text
from moireaug.mixtures import scenes_of
from moireaug.synthesis.pictures import Pictures, Source
from training.config import scenes
from training.config.plain_commands import parse, report_errors
from training.config.settings import setting
from training.demoireing.pictures import DrawnPictures, split_tenths
from training.detection.examples import PHOTO_SIDE, Examples
from training.detection.heads import LOOKS, Part
from training.detection.labelled import cross_validated, read_labelled, readable
from training.detection.measures import auc, line_of, measures, threshold_at
from training.detection.network import Detector, as_photo, shrunk
from training.system.files import make_folder

EXAMPLE = "python training/detect.py train images=DIR weights=resnet18.pth"
HELD_OUT_DIVISOR = 10  # a tenth of the rounds is left out of the training
MIN_SIDE = 32  # of pictures that train, pixels
DRAWN_ORDINARY = 100  # pictures that set the threshold where all are drawn
BATCH = 32


@dataclass
class Config:
    """All settings of the command."""

    images: str | None = setting(None, "folder of ordinary pictures; null: drawn")
    labelled: str | None = setting(
        None, "your photos, in folders real and screen, to train on, too"
    )
    ordinary: str | None = setting(
        None,
        "other photos without screens, for the threshold; null: labelled ones, a tenth of images",
    )
    scene: str = setting("anywhere", "of the screens: preset, or YAML file")
    weights: str | None = setting(MISSING, "of the backbone: file, name, or null for random")
    backbone: str = setting("resnet18", "ResNet of torchvision")
    out: str = setting("runs/detect", "folder of the results")
    n: int = setting(300, "batches of about eleven examples", bounds=(4, None))
    penalty: float = setting(0.5, "L2 penalty on the heads", bounds=(0, None))
    false_alarms: float = setting(0.1, "share of ordinary photos called screens", bounds=(0, 1))
    seed: int = setting(0, "of the examples", bounds=(0, 2**31))
    workers: int = setting(0, "processes; 0: this one", bounds=(0, 1024))


class SeenExample(NamedTuple):
    """An example as a head sees it: its features (F,), and the number of its round."""

    features: Tensor
    is_screen: bool
    kind: str
    number: int


def train(cfg: Config) -> dict[str, Any]:
    """Train, write and print; return what metrics.json holds.

    Raises:
        ValueError: no pictures, or weights that do not fit.
        OSError: the disk is full or not writable.
    """
    start = time.perf_counter()
    detector = Detector(cfg.backbone, cfg.weights)
    pictures, ordinary = sources(cfg)
    scene = scenes.load(cfg.scene)
    if not all(one.is_binned for one in scenes_of(scene)):
        raise ValueError(
            f"scene={cfg.scene} has no screen of a known size or distance: pass one that states "
            "panel.width or sensor.pitch, such as phone_at_monitor."
        )
    rounds = Examples(pictures, scene, cfg.seed)
    out = Path(cfg.out)
    make_folder(out, "out=DIR")
    labelled = read_labelled(detector, cfg.labelled) if cfg.labelled is not None else None
    seen = look_at(detector, rounds, cfg)
    rounds_of = {look: split_rounds(seen[look]) for look in LOOKS}
    parts = {look: [train] for look, (train, _) in rounds_of.items()}
    left_out = None
    if labelled:
        left_out = cross_validated(labelled, parts, cfg.penalty)
        parts = {look: [*parts[look], labelled.part(look)] for look in LOOKS}
    detector.heads.fit(parts, cfg.penalty)
    areas = {look: area_of(detector, look, held_out) for look, (_, held_out) in rounds_of.items()}
    others = [np.array([score_of(detector, picture) for picture in tqdm(ordinary, disable=None)])]
    if left_out and cfg.ordinary is None:
        others.append(left_out.others)
    threshold = threshold_at(cfg.false_alarms, others)
    detector.threshold.fill_(threshold)
    # not at the threshold, which these photos set
    judged = measures(*left_out, threshold=None) if left_out else None
    kinds = Counter(f"{look}: {one.kind}" for look in LOOKS for one in seen[look])
    metrics: dict[str, Any] = {
        "settings": vars(cfg),
        "examples": dict(kinds),
        "labelled": len(labelled.names) if labelled else 0,
        "cross_validated": judged,
        "auc": areas,
        "threshold": threshold,
        "seconds": time.perf_counter() - start,
    }
    detector.save(out / "detector.pt")
    write_text(out / "metrics.json", json.dumps(metrics, indent=1))
    figures = ", ".join(f"{look} {area:.3f}" for look, area in areas.items())
    print(f"AUC on simulated photos that were left out: {figures}")
    if judged:
        print(line_of("Labelled photos that were left out in turn", judged))
    print(f"Written in {metrics['seconds']:.0f} s: {out / 'detector.pt'}")
    return metrics


def look_at(detector: Detector, rounds: Examples, cfg: Config) -> dict[str, list[SeenExample]]:
    """Make the examples of all rounds, and return their features by look."""
    loader = DataLoader(
        rounds,
        batch_size=None,
        sampler=range(cfg.n),
        num_workers=cfg.workers,
        collate_fn=list,
    )
    seen: dict[str, list[SeenExample]] = {look: [] for look in LOOKS}
    for number, examples in enumerate(tqdm(loader, unit="round", disable=None)):
        for look in LOOKS:
            of_look = [example for example in examples if example.look == look]
            features = features_of(detector, [example.image for example in of_look])
            for row, example in zip(features, of_look, strict=True):
                seen[look].append(SeenExample(row, example.is_screen, example.kind, number))
    return seen


def split_rounds(seen: Sequence[SeenExample]) -> tuple[Part, Part]:
    """Return the examples of most rounds, and of the others."""
    features = torch.stack([one.features for one in seen])
    is_screen = torch.tensor([one.is_screen for one in seen])
    is_held_out = torch.tensor([one.number % HELD_OUT_DIVISOR == 0 for one in seen])
    train, held_out = ((features[rows], is_screen[rows]) for rows in (~is_held_out, is_held_out))
    return train, held_out


@torch.no_grad()
def area_of(detector: Detector, look: str, part: Part) -> float:
    """Return the area under the ROC curve of a look's head on examples."""
    features, is_screen = part
    logits = detector.heads.get_submodule(look)(features)[:, 0]
    return auc(logits[is_screen].numpy(), logits[~is_screen].numpy())


def sources(cfg: Config) -> tuple[Source, Iterable[Any]]:
    """Return the pictures that train, and the ordinary photos that set the threshold, of which at
    least one is usable."""
    pictures: Source = DrawnPictures(PHOTO_SIDE)
    ordinary = None
    if cfg.ordinary is not None:
        ordinary = Pictures(cfg.ordinary, 1)
    if cfg.images is not None:
        pictures = every = Pictures(cfg.images, MIN_SIDE)
        if ordinary is None:
            pictures, ordinary = split_tenths(every, 2)
    rng = np.random.default_rng((cfg.seed, 1))
    if ordinary is None:
        return pictures, [pictures.draw(rng)[1] for _ in range(DRAWN_ORDINARY)]
    ordinary.draw(rng)  # a folder without a usable one is refused before the training
    return pictures, usable(ordinary)


def usable(pictures: Pictures) -> Iterator[Any]:
    """Yield the pictures that are large enough, as large as a detector looks at them; all at once
    would fill the memory."""
    for _, picture in readable(pictures.folder, pictures.names):
        if min(picture.size) >= pictures.min_side:
            yield shrunk(picture)


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
