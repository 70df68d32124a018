"""A detector of screen photos on real ones, beside others on the same network.

    python benchmarks/detecting.py PHOTOS --detector runs/detect/detector.pt --images DIR

PHOTOS holds a folder for each collection, with folders named real and screen, as training/detect.py
score takes them. Rows, by collection: the detector, and each of its looks alone; heads that are
fitted on the real photos of all other collections, the mark to pass; the crops' head fitted on
crops of the pictures in DIR with a sinusoid in each colour, against the crops; and heads fitted on
a few photos of the collection itself, with simulated ones and without, judged on its others (means
of three draws). Writes results/detecting.csv, detecting.png (ROC curves) and, beside the detector,
mistakes.png.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

import numpy as np
import pandas as pd
import torch
from PIL import Image
from torch import Tensor, nn

from benchmarks import measure
from benchmarks.other_libraries import overlay
from moireaug.common.files import write_bytes
from moireaug.synthesis.pictures import Pictures
from training.config import scenes
from training.detection.examples import Examples, part_of, saved
from training.detection.fit import Config, look_at, sources
from training.detection.heads import LOOKS, Part, Parts, fit_head
from training.detection.labelled import (
    LabelledPhotos,
    collection_of,
    cross_validated,
    heads_of,
    read_labelled,
)
from training.detection.measures import measures, roc_plot, threshold_at
from training.detection.network import CROP_SIDE, Detector, as_photo
from training.detection.score import judge

PENALTY = 0.5
OWN = (5, 20)  # photos of each kind of a collection, as a user might label
DRAWS = 3  # of these
FALSE_ALARMS = 0.1
MEANS = ("auc", "eer", "found_at_10", "apcer", "bpcer")
Seen = dict[str, Tensor]  # features by look
NONE: Parts = {look: [] for look in LOOKS}


def fitted(*parts: Part) -> nn.Module:
    """Return a head on parts of examples, which weigh the same."""
    head = nn.Linear(parts[0][0].shape[1], 1)
    fit_head(head, parts, PENALTY)
    return head


def of_others(photos: LabelledPhotos, group: np.ndarray) -> Tensor:
    """Return the scores of photos by heads fitted on all other collections."""
    scores = torch.zeros(len(group))
    for name in np.unique(group):
        left_out = torch.from_numpy(group == name)
        heads = heads_of(photos.subset(~left_out), NONE, PENALTY)
        scores[left_out] = heads(photos.crops[left_out], photos.wholes[left_out])
    return scores


def simulated_parts(detector: Detector, cfg: Config) -> Parts:
    """Return by look the part of examples that a detector is fitted to."""
    rounds = Examples(sources(cfg)[0], scenes.load(cfg.scene), cfg.seed)
    found = {}
    for look, seen in look_at(detector, rounds, cfg).items():
        features = torch.stack([one.features for one in seen])
        found[look] = [(features, torch.tensor([one.is_screen for one in seen]))]
    return found


@torch.no_grad()
def with_own(
    photos: LabelledPhotos, rows: np.ndarray, n: int, parts: Parts, ordinary: Seen
) -> dict[str, float]:
    """Return how well heads do on one collection after n screens and n others of it, and further
    parts; the mean of some draws.

    Args:
        ordinary: features of photos by look which set the threshold, besides those of n others.
    """
    found = []
    for seed in range(DRAWS):
        order = np.random.default_rng(seed).permutation(np.flatnonzero(rows))
        is_screen = photos.is_screen.numpy()[order]
        chosen = torch.zeros(len(rows), dtype=torch.bool)
        chosen[[*order[is_screen][:n], *order[~is_screen][:n]]] = True
        train, test = photos.subset(chosen), photos.subset(torch.from_numpy(rows) & ~chosen)
        heads, left_out = heads_of(train, parts, PENALTY), cross_validated(train, parts, PENALTY)
        assert left_out
        alarms = [heads(ordinary["crop"], ordinary["whole"]).numpy(), left_out.others]
        threshold = threshold_at(FALSE_ALARMS, alarms)
        scores = heads(test.crops, test.wholes)
        both = [scores[rows].numpy() for rows in (test.is_screen, ~test.is_screen)]
        screens, of_others = both
        found.append(measures(screens, of_others, threshold))
    return {key: float(np.mean([row[key] for row in found])) for key in MEANS}


def features_by_look(detector: Detector, pictures: Iterable[Image.Image]) -> Seen:
    """Return what the heads see of pictures, by look."""
    seen = [detector.seen(as_photo(picture)) for picture in pictures]
    return {look: torch.cat([one[look] for one in seen]) for look in LOOKS}


def sinusoid_head(detector: Detector, folder: str, n: int) -> nn.Module:
    """Return a crops' head that tells n crops from the same with a sinusoid in each colour."""
    pictures, rng = Pictures(folder, CROP_SIDE), np.random.default_rng(0)
    features, truth = [], []
    size = (CROP_SIDE, CROP_SIDE)
    for _ in range(n):
        crop = as_photo(part_of(rng, pictures.draw(rng)[1], size))
        for image, is_screen in ((crop, False), (overlay(crop), True)):
            codes = saved(rng, image, CROP_SIDE)
            features.append(detector.features(codes[None].float() / 255)[0])
            truth.append(is_screen)
    return fitted((torch.stack(features), torch.tensor(truth)))


@torch.no_grad()
def main() -> None:
    parser = measure.arguments(__doc__)
    parser.add_argument("photos", help="a folder of collections")
    parser.add_argument("--detector", type=Path, required=True)
    parser.add_argument("--images", required=True, help="a folder of ordinary pictures")
    parser.add_argument("--rounds", type=int, default=300, help="as n= of training/detect.py")
    args, n, _ = measure.begin(parser, 150, 4)
    torch.manual_seed(0)
    detector = Detector.load(args.detector)
    photos = read_labelled(detector, args.photos)
    truth, group = photos.is_screen, np.array([collection_of(name) for name in photos.names])
    crops = detector.heads.crop(photos.crops)[..., 0]
    sinusoids = sinusoid_head(detector, args.images, n)(photos.crops)[..., 0]
    scores = {
        "the detector": detector.heads(photos.crops, photos.wholes),
        "its crops alone": crops.mean(1) + crops.amax(1),
        "its whole photos alone": detector.heads.whole(photos.wholes)[:, 0],
        "a sinusoid in each colour, crops alone": sinusoids.mean(1) + sinusoids.amax(1),
        "real photos of the others": of_others(photos, group),
    }
    rows: list[dict[str, Any]] = []
    curves = {}
    for kind, values in scores.items():
        for name in np.unique(group):
            screens, others = (values[(group == name) & (truth.numpy() == t)] for t in (1, 0))
            threshold = None
            if kind == "the detector":
                threshold = detector.threshold.item()
                curves[str(name)] = (screens.numpy(), others.numpy())
            found = measures(screens.numpy(), others.numpy(), threshold)
            rows.append({"trained on": kind, "collection": name} | found)
    cfg = Config(images=args.images, weights=None, n=args.rounds)
    simulated = simulated_parts(detector, cfg)
    ordinary = features_by_look(detector, sources(cfg)[1])
    for number in OWN:
        for kind, others in (("", NONE), ("simulated photos and ", simulated)):
            for name in np.unique(group):
                if min(np.bincount(truth[group == name], minlength=2)) <= number:
                    continue  # nothing would be left to judge
                found = with_own(photos, group == name, number, others, ordinary)
                label = f"{kind}{number} screens and {number} others of its own"
                rows.append({"trained on": label, "collection": name} | found)
    frame = pd.DataFrame(rows)
    table = pd.DataFrame(
        {"photo": photos.names, "score": scores["the detector"], "truth": truth.numpy()}
    )
    judge(table, detector.threshold.item(), Path(args.photos), args.detector.parent)
    print(frame.pivot(index="trained on", columns="collection", values="auc").round(2))
    print(frame.groupby("trained on", sort=False)[list(MEANS)].mean().round(3))
    measure.publish(frame, measure.results(args) / "detecting.csv")
    write_bytes(measure.results(args) / "detecting.png", roc_plot(curves))


if __name__ == "__main__":
    main()
