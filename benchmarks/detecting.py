"""A detector of screen photos on real ones, beside others on the same network.

    python benchmarks/detecting.py PHOTOS --detector runs/detect/detector.pt --images DIR

PHOTOS holds a folder for each collection, with folders named real and screen, as training/detect.py
score takes them. Rows, by collection: the detector, and each of its looks alone; heads that are
fitted on the real photos of all other collections, the mark to pass; and the crops' head fitted on
crops of the pictures in DIR with a sinusoid in each colour, against the crops. Writes
results/detecting.csv, detecting.png (ROC curves) and, beside the detector, mistakes.png.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

import numpy as np
import pandas as pd
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from benchmarks import measure
from benchmarks.other_libraries import overlay
from moireaug.common.files import write_bytes
from moireaug.common.image_files import read_picture
from moireaug.synthesis.pictures import Pictures
from training.detection.examples import part_of, saved
from training.detection.measures import measures, roc_plot
from training.detection.network import (
    CROP_SIDE,
    WHOLE_SIDE,
    Detector,
    as_photo,
    at_photo_size,
    crops_of,
    fit_head,
    pooled_score,
)
from training.detection.score import collection_of, judge, truth_of

PENALTY = 0.5


def looks(detector: Detector, photo: Tensor) -> tuple[Tensor, Tensor]:
    """Return the features of a photo's crops (crops, F), and of the whole of it (F,)."""
    photo = at_photo_size(photo)
    whole = F.interpolate(photo, (WHOLE_SIDE, WHOLE_SIDE), mode="bilinear", antialias=True)
    return detector.features(crops_of(photo)[0]), detector.features(whole)[0]


def scored(crop_head: nn.Module, whole_head: nn.Module, crops: Tensor, wholes: Tensor) -> Tensor:
    """Return the scores (N,) of features (N, crops, F) and (N, F)."""
    return pooled_score(crop_head(crops)[..., 0], whole_head(wholes)[:, 0])


def fitted(features: Tensor, truth: Tensor) -> nn.Module:
    """Return a head on features (N, F)."""
    head = nn.Linear(features.shape[1], 1)
    fit_head(head, features, truth.tolist(), PENALTY)
    return head


def of_others(crops: Tensor, wholes: Tensor, truth: Tensor, group: np.ndarray) -> Tensor:
    """Return the scores of photos by heads fitted on all other collections."""
    scores = torch.zeros(len(truth))
    for name in np.unique(group):
        left_out = torch.from_numpy(group == name)
        rows = truth[~left_out]
        crop_head = fitted(crops[~left_out].flatten(0, 1), rows.repeat_interleave(crops.shape[1]))
        whole_head = fitted(wholes[~left_out], rows)
        scores[left_out] = scored(crop_head, whole_head, crops[left_out], wholes[left_out])
    return scores


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
    return fitted(torch.stack(features), torch.tensor(truth))


@torch.no_grad()
def main() -> None:
    parser = measure.arguments(__doc__)
    parser.add_argument("photos", help="a folder of collections")
    parser.add_argument("--detector", type=Path, required=True)
    parser.add_argument("--images", required=True, help="a folder of ordinary pictures")
    args, n, _ = measure.begin(parser, 150, 4)
    torch.manual_seed(0)
    detector, pictures = Detector.load(args.detector), Pictures(args.photos, 1)
    names = [name for name in pictures.names if truth_of(name) is not None]
    seen = [looks(detector, as_photo(read_picture(pictures.folder / name))) for name in names]
    crops, wholes = (torch.stack(list(part)) for part in zip(*seen, strict=True))
    truth = torch.tensor([bool(truth_of(name)) for name in names])
    group = np.array([collection_of(name) for name in names])
    crop_head, whole_head = detector.heads["crop"], detector.heads["whole"]
    logits = crop_head(crops)[..., 0]
    scores = {
        "the detector": scored(crop_head, whole_head, crops, wholes),
        "its crops alone": logits.mean(1) + logits.amax(1),
        "its whole photos alone": whole_head(wholes)[:, 0],
    }
    sinusoids = sinusoid_head(detector, args.images, n)(crops)[..., 0]
    scores["a sinusoid in each colour, crops alone"] = sinusoids.mean(1) + sinusoids.amax(1)
    scores["real photos of the others"] = of_others(crops, wholes, truth, group)
    rows: list[dict[str, Any]] = []
    curves = {}
    for kind, values in scores.items():
        for name in np.unique(group):
            screens, others = (values[(group == name) & (truth.numpy() == t)] for t in (1, 0))
            found = measures(screens.numpy(), others.numpy(), detector.threshold.item())
            if kind == "the detector":
                curves[str(name)] = (screens.numpy(), others.numpy())
            else:  # whose threshold is nobody's
                found = {key: value for key, value in found.items() if "pcer" not in key}
            rows.append({"trained on": kind, "collection": name} | found)
    frame = pd.DataFrame(rows)
    table = pd.DataFrame({"photo": names, "score": scores["the detector"], "truth": truth.numpy()})
    judge(table, detector.threshold.item(), pictures.folder, args.detector.parent)
    print(frame.pivot(index="trained on", columns="collection", values="auc").round(2))
    print(frame.groupby("trained on", sort=False)[["auc", "eer", "found_at_10"]].mean().round(3))
    measure.publish(frame, measure.results(args) / "detecting.csv")
    write_bytes(measure.results(args) / "detecting.png", roc_plot(curves))


if __name__ == "__main__":
    main()
