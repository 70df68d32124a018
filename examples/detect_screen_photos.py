"""Train a detector of screen photos on simulated ones alone, and test it on real ones.

Positives are photos of crops by `scene="anywhere"`. Negatives are the crops, and their twins, which
share camera, light and noise but have no moiré.

    python examples/detect_screen_photos.py
    python examples/detect_screen_photos.py --pictures DIR --weights FILE --real DIR DIR

Each DIR of --real holds folders named real and screen. Prints areas under ROC curves; see roc.png.
"""

import argparse

import skimage
import torch
from matplotlib.figure import Figure
from torch import Tensor, nn
from torch.nn.functional import pad
from torchmetrics.functional.classification import binary_auroc, binary_roc
from torchvision import datasets, models
from torchvision.transforms import v2

from moireaug.defenses import JPEG
from moireaug.synthesis import Pairs

SIDE = 224
SHRINK = v2.Compose([v2.PILToTensor(), v2.Resize(None, max_size=1024)])  # as messengers do
FIVE_CROPS = v2.Compose([SHRINK, v2.FiveCrop(SIDE), torch.stack])


def pooled(network: nn.Module, crops: Tensor) -> Tensor:
    """Return features (B, F) of crops (B, 3, SIDE, SIDE): texture, by a network's first stages."""
    x, means = (crops - 0.45) / 0.225, []  # about ImageNet's mean and deviation
    for stage in list(network.children())[:-1]:
        x = stage(x)
        if isinstance(stage, nn.Sequential):
            means.append(x.mean((2, 3)))
    return torch.cat(means[:3], 1)


@torch.no_grad()
def main() -> None:
    """Train, then test on new crops and on real photos."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--pictures", default=skimage.data_dir)
    parser.add_argument("--crops", type=int, default=200, help="a half of them trains")
    parser.add_argument("--backbone", default="resnet18", help="torchvision's name")
    parser.add_argument("--weights", help="its state_dict; random weights if left out")
    parser.add_argument("--real", nargs="*", default=[], help="folders of real photos")
    args = parser.parse_args()
    torch.manual_seed(0)
    network = models.get_model(args.backbone).eval()
    if args.weights:
        network.load_state_dict(torch.load(args.weights))
    features = []
    for pair in Pairs(args.pictures, "anywhere", SIDE, twin=True, n=args.crops):
        crops = torch.stack([pair[kind] for kind in ("photo", "twin", "original")])
        features.append(pooled(network, JPEG(int(torch.randint(60, 96, ())))(crops)))
    x, y = torch.cat(features), torch.tensor([1, 0, 0]).repeat(len(features))
    mean, std, half = x.mean(0), x.std(0) + 1e-6, len(x) // 6 * 3
    rows, target = pad((x[:half] - mean) / std, (0, 1), value=1.0), 2.0 * y[:half] - 1
    balanced = rows * (0.75 + target[:, None] / 4)  # one photo among two others
    ridge = torch.eye(rows.shape[1]) * half
    weights = torch.linalg.solve(rows.T @ balanced + ridge, balanced.T @ target)
    tests = {"simulated": (x[half:, None], y[half:])}
    for folder in args.real:
        photos, classes = zip(*datasets.ImageFolder(folder, FIVE_CROPS), strict=True)
        x = torch.stack([pooled(network, crops / 255) for crops in photos])
        tests[folder] = x, torch.tensor(classes)
    axes = Figure().subplots(subplot_kw={"xlabel": "false alarms", "ylabel": "screens found"})
    for name, (x, y) in tests.items():
        scores = (pad((x - mean) / std, (0, 1), value=1.0) @ weights).mean(1)
        print(label := f"{name}: {y.sum()} of {len(y)} screens, AUC {binary_auroc(scores, y):.3f}")
        axes.plot(*binary_roc(scores, y)[:2], label=label)
    axes.legend()
    axes.figure.savefig("roc.png")


if __name__ == "__main__":
    main()
