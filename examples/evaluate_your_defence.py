"""Evaluate your own defence.

A defence is any function from images to images. `defenses.Defended` puts it in front of a model,
and an attack then goes through both. The defence is tested twice: against attacks that know of it,
which gives the honest figure, and against noise made for the bare model, which makes weak defences
look strong.

    python examples/evaluate_your_defence.py

Prints the ladders of the bare and the defended model, and the accuracy of the defended model under
noise made without knowing of the defence.
"""

import argparse
import sys
from pathlib import Path

import pandas as pd
import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.utils.data import DataLoader, TensorDataset

from moireaug import attacks, defenses, evaluation

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the repository, for `training`

from training.data import signs
from training.models.small_resnet import SmallResNet

ATTACK_SETTINGS = {"eps": 4 / 255, "shrink": (1, 3)}  # images are crops of larger photos


def halved(images: Tensor) -> Tensor:
    """Shrink images to half their size and enlarge them again: your defence goes here."""
    small = F.interpolate(images, scale_factor=0.5, mode="area")
    return F.interpolate(small, size=images.shape[-2:], mode="bilinear")  # stays in [0, 1]


def train(images: Tensor, labels: Tensor, epochs: int) -> nn.Module:
    """Train a small network on images (N, 3, H, W) in [0, 1]."""
    model = SmallResNet(len(signs.CLASSES))
    optimizer = torch.optim.AdamW(model.parameters(), lr=3e-3, weight_decay=0.05)
    for _ in range(epochs):
        for rows in torch.randperm(len(images)).split(64):
            optimizer.zero_grad()
            F.cross_entropy(model(images[rows]), labels[rows]).backward()
            optimizer.step()
    return model.eval()


def main() -> None:
    """Train, then evaluate with and without the defence."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--images", type=int, default=2000, help="training images")
    parser.add_argument("--epochs", type=int, default=10)
    parser.add_argument("--attacked", type=int, default=100, help="test images that are attacked")
    parser.add_argument("--steps", type=int, default=10)
    args = parser.parse_args()

    torch.manual_seed(0)
    codes, labels = signs.make("train", args.images, size=32)
    model = train(codes.float() / 255, labels, args.epochs)
    defended = defenses.Defended(model, halved)

    test = TensorDataset(*signs.make("test", args.attacked, size=32))
    loader = DataLoader(test, batch_size=50)
    columns = {}
    for name, judged in (("bare", model), ("defended", defended)):
        frame = evaluation.evaluate(judged, loader, steps=args.steps, **ATTACK_SETTINGS)
        columns[name] = evaluation.rates(frame).set_index("row")["accuracy"]
    print(pd.DataFrame(columns).map("{:.0%}".format))

    images, labels = next(iter(loader))
    blind = attacks.MoireAttack(model, scene="screen_photo", steps=args.steps, **ATTACK_SETTINGS)
    result = blind(images.float() / 255, labels)
    answers = defended(result.images).argmax(1)
    rate = (answers == labels).float().mean()
    print(f"defended, against noise that does not know of the defence: {rate:.0%}")


if __name__ == "__main__":
    main()
