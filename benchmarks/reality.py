"""Compare scenes with real photos of screens.

    python benchmarks/reality.py PAIRS.csv screen_photo phone_at_monitor scene.yaml
    python benchmarks/reality.py PAIRS.csv screen_photo --classifiers DIR

PAIRS.csv has the columns photo and original: aligned pictures of one size. Publishes figures only,
no pictures. For each scene:

- statistics: of crops of the real photos and of the scene's photos of the same crops, as
  training/calibrate.py computes them.
- told apart: a small network is trained to tell patches of the real photos from simulated ones of
  the same crops, on all folds of the pictures but one, and judged on that one. 50 % is chance:
  such a network cannot tell the scene from reality. "as they are" judges everything; "one tone"
  after the best global colour map of every crop onto its original, which leaves the texture alone:
  moiré, noise, sharpness. With --controls, two more are judged: the real photos against themselves,
  which must be at chance, and the originals, which are no photos at all.
- agreement, with --classifiers, a folder of torchvision's ImageNet weights: on what share of the
  pictures each classifier gives the same answer for the photo as for the original, for the real
  photos and for the scene's of the whole pictures.

Writes results/reality.json, or with --only results/reality-PART.json.
"""

from __future__ import annotations

import sys
import time
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

import pandas as pd
import torch
from torch import Tensor

from benchmarks import agreement, measure, told_apart
from moireaug import Scene
from training.calibration.compare import (
    Crops,
    compare_statistics,
    cut_crops,
    mean_distance,
    measure_crops,
    photograph_crops,
    terminal_parts,
)
from training.config import scenes
from training.data.real_pairs import find_pairs, read_pairs
from training.photographs.tone import ColourMap

FULL_SETTINGS: dict[str, Any] = {
    "side": 384,
    "each": 8,
    "shots": 3,
    "apart": told_apart.Effort(),
    "agreement": agreement.Sizes(),
}
QUICK_SETTINGS: dict[str, Any] = {
    "side": 48,
    "each": 2,
    "shots": 1,
    "apart": told_apart.Effort(steps=2, batch=4, side=32, judged=8),
    "agreement": agreement.Sizes(judged=64, shrunk=(48, 32)),
}
CONTROLS = ("the real photos", "the originals")
CROP_PARTS = ("statistics", "apart")
PARTS = (*CROP_PARTS, "agreement")


def simulated(scene: Scene, crops: Crops, shots: int) -> Tensor:
    """Return `shots` photos of every crop, (shots, N, 3, S, S) uint8."""
    return torch.stack([photograph_crops(scene, crops.originals, seed) for seed in range(shots)])


def one_tone(photos: Tensor, originals: Tensor) -> Tensor:
    """Return photos after the best global colour map onto their originals, as 8-bit codes."""
    mapped = []
    for photo, original in zip(photos.float().numpy(), originals.float().numpy(), strict=True):
        mapped.append(torch.from_numpy(ColourMap.fit(photo, original)(photo)))
    return torch.stack(mapped).round().to(torch.uint8)


def statistics(crops: Crops, photos: dict[str, Tensor]) -> dict[str, Any]:
    """Return every scene's statistics beside those of the real photos."""
    real = measure_crops(crops.photos, crops.originals)
    found = {}
    for name, shots in photos.items():
        table = compare_statistics(real, measure_crops(shots[0], crops.originals))
        told = "\n".join(terminal_parts(table, name))
        print(f"Statistics of {name}, {len(real)} crops\n{told}\n", flush=True)
        rows = [line.to_dict() for line in table]
        found[name] = {"distance": mean_distance(table), "rows": rows}
    return found


def tell(
    crops: Crops, others: dict[str, Tensor], effort: told_apart.Effort
) -> list[dict[str, Any]]:
    """Return a row for each of the others and each tone: how well it is told from the photos."""
    rows = []
    plain = one_tone(crops.photos, crops.originals)
    for name, photos in others.items():
        toned = torch.stack([one_tone(shot, crops.originals) for shot in photos])
        for tone, real, other in (
            ("as they are", crops.photos, photos),
            ("one tone", plain, toned),
        ):
            began = time.perf_counter()
            accuracies = told_apart.accuracy_of_telling(real, other, crops, effort)
            row = {"scene": name, "tone": tone} | told_apart.summarised(accuracies)
            row |= {"accuracies": accuracies, "seconds": time.perf_counter() - began}
            rows.append(row)
    print(f"Told apart, {len(crops.names)} pictures: mean accuracy, 95 % interval; 0.5 is chance")
    print(measure.text_of(pd.DataFrame(rows).drop(columns="accuracies")), end="\n\n", flush=True)
    return rows


def of_crops(
    crops: Crops,
    chosen: dict[str, Scene],
    args: Namespace,
    parts: Sequence[str],
    settings: dict[str, Any],
) -> dict[str, Any]:
    """Return the measures that compare crops of the real photos with the scenes' photos of them."""
    shots = settings["shots"]
    photos = {name: simulated(scene, crops, shots) for name, scene in chosen.items()}
    found: dict[str, Any] = {}
    if "statistics" in parts:
        found["statistics"] = statistics(crops, photos)
    if "apart" in parts:
        others: dict[str, Tensor] = {}
        if args.controls:
            others = dict(zip(CONTROLS, (crops.photos[None], crops.originals[None]), strict=True))
        found["told_apart"] = tell(crops, others | photos, settings["apart"])
    return found


def main() -> None:
    parser = measure.arguments(__doc__)
    parser.add_argument("pairs", type=Path, help="a CSV file with the columns photo and original")
    parser.add_argument("scenes", nargs="+", help="presets or YAML files")
    parser.add_argument("--controls", action="store_true", help="also tell the two controls apart")
    parser.add_argument("--classifiers", type=Path, help="a folder of files such as resnet18.pth")
    parser.add_argument(
        "--only", nargs="+", choices=PARTS, help="these parts; they get a file of their own"
    )
    args, settings, facts = measure.begin(parser, FULL_SETTINGS, QUICK_SETTINGS)
    parts = args.only or PARTS
    if "agreement" in (args.only or ()) and not args.classifiers:
        parser.error(
            "--only agreement asks ImageNet classifiers: pass their folder, --classifiers DIR."
        )
    try:
        chosen = {name: scenes.load(name) for name in args.scenes}
        pairs = find_pairs(args.pairs)
        if "apart" in parts and len(pairs) < 2:
            raise ValueError(
                f"{args.pairs} holds one pair, and telling photos apart needs at least two, as one "
                "is left out at a time. Add pairs, or pass --only statistics."
            )
        crops = None
        if set(CROP_PARTS) & set(parts):
            crops = cut_crops(read_pairs(pairs), settings["side"], settings["each"])
        classifiers = None
        if "agreement" in parts and args.classifiers:
            classifiers = agreement.read_classifiers(args.classifiers)
    except (ValueError, OSError) as error:
        parser.error(str(error))
    found: dict[str, Any] = {}
    if crops:
        found |= of_crops(crops, chosen, args, parts, settings)
    if classifiers:
        sizes = settings["agreement"]
        found["agreement"] = agreement.agree(classifiers, read_pairs(pairs), chosen, sizes)
    name = "-".join(["reality", *(args.only or [])])
    measure.write_json(args, name, metadata=facts, **found)


if __name__ == "__main__":
    main()
