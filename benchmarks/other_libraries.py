"""Simulated photos of screens beside other libraries' moiré, on the same pictures.

    pip install augraphy
    python benchmarks/other_libraries.py --pictures DIR --weights resnet18.pth --real DIR DIR

Three measures of each: milliseconds for a picture of 224 px, on one thread; strength of colour and
luma in the bands of moiré, in codes of 255 (of real photos: docs/appendix/real_photos.md); and the
area under the ROC curve on collections of real photos, of the detector of
examples/detect_screen_photos.py with these pictures as positives. Each DIR of --real holds folders
named real and screen. Augraphy's rows are left out where it is not installed. Writes
results/other_libraries.csv, and a picture of each beside it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

import numpy as np
import pandas as pd
import skimage
import torch
from matplotlib.figure import Figure
from scipy.ndimage import gaussian_filter
from torch import Tensor
from torch.nn.functional import pad
from torchmetrics.functional.classification import binary_auroc
from torchvision import datasets, models

from benchmarks import measure
from examples.detect_screen_photos import FIVE_CROPS, SIDE, pooled
from moireaug.defenses import JPEG
from moireaug.synthesis import Pairs
from moireaug.transforms import RandomMoire

Moire = Callable[[Tensor], Tensor]  # images (B, 3, H, W) in [0, 1] to the same
BAND = (1.5, 8.0)  # deviations of the Gaussians around the bands of moiré, in pixels
FLAT_SHARE = 0.4  # of a picture, in which the strength is measured


def overlay(images: Tensor) -> Tensor:
    """Multiply images by a sinusoid in each colour: what is often written by hand."""
    n, _, h, w = images.shape
    y, x = torch.arange(h)[:, None], torch.arange(w)
    frequency, angle = 0.02 + 0.2 * torch.rand(n, 3, 1, 1), torch.pi * torch.rand(n, 3, 1, 1)
    phase = 2 * torch.pi * torch.rand(n, 3, 1, 1)
    along = angle.cos() * x + angle.sin() * y
    wave = (2 * torch.pi * frequency * along + phase).sin()
    return (images * (1 + 0.08 * wave)).clamp(0, 1)


def by_array(augment: Callable[[np.ndarray], np.ndarray], images: Tensor) -> Tensor:
    """Call a library of NumPy images, (H, W, 3) uint8, on each image of a batch."""
    out = []
    for image in images:
        array = (255 * image).round().byte().permute(1, 2, 0).numpy()
        out.append(torch.from_numpy(np.ascontiguousarray(augment(array))).permute(2, 0, 1))
    return torch.stack(out).float() / 255


def moires() -> dict[str, Moire]:
    """Return what makes moiré, by name."""
    found: dict[str, Moire] = {
        "RandomMoire, screen_photo": RandomMoire("screen_photo", p=1),
        "RandomMoire, anywhere": RandomMoire("anywhere", p=1),
        "a sinusoid in each colour": overlay,
    }
    try:
        import augraphy
    except ImportError:
        return found
    for name in ("Moire", "LCDScreenPattern"):
        found[f"Augraphy's {name}"] = partial(by_array, getattr(augraphy, name)(p=1))
    return found


def strength(images: Tensor, pictures: Tensor) -> tuple[float, float]:
    """Return the median strength of colour and of luma, in codes: the root mean square of a band in
    the parts of each picture that are flattest in it."""
    colours, lumas = [], []
    for image, picture in zip(bands(images), bands(pictures), strict=True):
        busy = gaussian_filter(np.abs(picture[2]), 6)
        flat = busy <= np.quantile(busy, FLAT_SHARE)
        colours.append(np.sqrt((image[:2] ** 2).sum(0)[flat].mean()))
        lumas.append(np.sqrt((image[2] ** 2)[flat].mean()))
    return float(np.median(colours)), float(np.median(lumas))


def bands(images: Tensor) -> np.ndarray:
    """Return R - G, B - G and luma in the band of moiré, (B, 3, H, W), in codes."""
    r, g, b = 255 * images.numpy().transpose(1, 0, 2, 3)
    planes = np.stack([r - g, b - g, (r + g + b) / 3], 1)
    fine, coarse = (gaussian_filter(planes, (0, 0, s, s)) for s in BAND)
    return fine - coarse


def ridge(x: Tensor, y: Tensor) -> Callable[[Tensor], Tensor]:
    """Return the scores of a ridge regression on features x (N, F) and classes y (N,), which are
    weighted alike."""
    mean, std = x.mean(0), x.std(0) + 1e-6
    rows, target = pad((x - mean) / std, (0, 1), value=1.0), 2.0 * y - 1
    shares = torch.where(y == 1, 1 / y.sum(), 1 / (1 - y).sum()) * len(y) / 2
    balanced = rows * shares[:, None]
    weights = torch.linalg.solve(
        rows.T @ balanced + len(y) * torch.eye(rows.shape[1]), balanced.T @ target
    )
    return lambda new: pad((new - mean) / std, (0, 1), value=1.0) @ weights


def figure(images: dict[str, Tensor]) -> Figure:
    """Return one picture as each makes it, at native pixels."""
    fig = Figure(figsize=(2.4 * len(images), 2.7), layout="constrained", facecolor="white")
    for ax, (name, image) in zip(fig.subplots(1, len(images)), images.items(), strict=True):
        ax.imshow(image.permute(1, 2, 0))
        ax.set_title(name, size=8)
        ax.axis("off")
    return fig


@torch.no_grad()
def main() -> None:
    parser = measure.arguments(__doc__)
    parser.add_argument("--pictures", default=skimage.data_dir)
    parser.add_argument("--weights", type=Path, help="a resnet18's state_dict; random without it")
    parser.add_argument("--real", nargs="*", default=[], help="folders of real photos")
    parser.set_defaults(threads=1)
    args, (n, repeats), _ = measure.begin(parser, (150, 15), (4, 1))
    torch.manual_seed(0)
    network = models.get_model("resnet18").eval()
    if args.weights:
        network.load_state_dict(torch.load(args.weights))
    pairs = list(Pairs(args.pictures, "anywhere", SIDE, twin=True, n=n))
    pictures = torch.stack([pair["original"] for pair in pairs])
    twins = torch.stack([pair["twin"] for pair in pairs])
    found = moires()
    photos = {name: moire(pictures) for name, moire in found.items()}
    # those whose twins are negatives below
    photos["RandomMoire, anywhere"] = torch.stack([pair["photo"] for pair in pairs])
    times = measure.timed_together(
        {name: partial(moire, pictures[:4]) for name, moire in found.items()}, repeats
    )

    def features(crops: Tensor) -> Tensor:
        parts = [pooled(network, JPEG(int(torch.randint(60, 96, ())))(c[None])) for c in crops]
        return torch.cat(parts)

    tests = {}
    for folder in args.real:
        data = datasets.ImageFolder(folder, FIVE_CROPS)
        if data.classes != ["real", "screen"]:
            parser.error(f"{folder} must hold the folders real and screen; got {data.classes}.")
        crops, classes = zip(*data, strict=True)
        tests[Path(folder).name] = (
            torch.cat([pooled(network, c / 255) for c in crops]),
            torch.tensor(classes),
        )
    others = {"": features(pictures)}
    others[", twins as negatives"] = torch.cat([others[""], features(twins)])
    colour, luma = strength(pictures, pictures)
    rows: list[dict[str, Any]] = [{"moire": "the pictures", "colour": colour, "luma": luma}]
    for name, made in photos.items():
        colour, luma = strength(made, pictures)
        row = {"moire": name, "ms": 1e3 * times[name].median / 4, "colour": colour, "luma": luma}
        positives = features(made)
        for negatives, x in others.items():
            if negatives and name != "RandomMoire, anywhere":
                continue
            y = torch.cat([torch.ones(len(positives)), torch.zeros(len(x))])
            score = ridge(torch.cat([positives, x]), y)
            aurocs = {}
            for collection, (real, classes) in tests.items():
                scores = score(real).view(len(classes), -1).mean(1)
                aurocs[collection] = float(binary_auroc(scores, classes))
            rows.append(row | {"moire": name + negatives} | aurocs)
    out = measure.results(args)
    measure.publish(pd.DataFrame(rows), out / "other_libraries.csv")
    astronaut = torch.from_numpy(skimage.data.astronaut()[:SIDE, 100 : 100 + SIDE].copy())
    shown = astronaut.permute(2, 0, 1)[None] / 255
    images = {"the picture": shown[0]} | {name: moire(shown)[0] for name, moire in found.items()}
    figure(images).savefig(out / "other_libraries.png", dpi=100)


if __name__ == "__main__":
    main()
