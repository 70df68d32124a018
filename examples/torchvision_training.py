"""Train a classifier with RandomMoire in a torchvision pipeline.

Trains a small network twice on generated traffic signs: on the pictures alone, and with
`RandomMoire` in the data set's `v2.Compose`, so that half of them are photographed off a screen.
Both are tested on clean pictures and on photos of a scene that neither has seen.

    python examples/torchvision_training.py

Prints the accuracy of both networks on both tests. Takes about two minutes on one core.
"""

import argparse
import sys
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import nn
from torch.utils.data import DataLoader, Dataset
from torchvision.transforms import v2

from moireaug import Scene
from moireaug.transforms import RandomMoire

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the repository, for `training`

from training.data import signs


class Signs(Dataset):
    """Generated signs, passed through a transform."""

    def __init__(self, n: int, transform: v2.Transform) -> None:
        self.transform, (self.images, self.labels) = transform, signs.make("train", n, size=32)

    def __len__(self) -> int:
        return len(self.images)

    def __getitem__(self, index: int) -> tuple[torch.Tensor, torch.Tensor]:
        return self.transform(self.images[index]), self.labels[index]


def train(p: float, n: int, epochs: int) -> nn.Module:
    """Train a network with a share `p` of its pictures photographed off a screen."""
    moire = RandomMoire(scene="screen_photo", p=p, shrink=(1, 3))  # images are crops
    transform = v2.Compose([v2.RandomCrop(32, 3), moire, v2.ToDtype(torch.float32, scale=True)])
    layers: list[nn.Module] = []
    for inputs, outputs in ((3, 32), (32, 64), (64, 128)):
        layers += [nn.Conv2d(inputs, outputs, 3, 2, 1), nn.BatchNorm2d(outputs), nn.ReLU()]
    model = nn.Sequential(*layers, nn.Flatten(), nn.Linear(128 * 4 * 4, len(signs.CLASSES)))
    optimizer = torch.optim.AdamW(model.parameters(), lr=3e-3, weight_decay=0.05)
    loader = DataLoader(Signs(n, transform), batch_size=64, shuffle=True)
    for _ in range(epochs):
        for images, labels in loader:
            optimizer.zero_grad()
            F.cross_entropy(model(images), labels).backward()
            optimizer.step()
    return model.eval()


@torch.no_grad()
def accuracy(model: nn.Module, images: torch.Tensor, labels: torch.Tensor) -> float:
    """Return the share of images that a model classifies correctly."""
    return (model(images).argmax(1) == labels).float().mean().item()


def main() -> None:
    """Train and test with and without RandomMoire."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--images", type=int, default=2000)
    parser.add_argument("--epochs", type=int, default=10)
    args = parser.parse_args()
    codes, labels = signs.make("test", min(args.images, 480), size=32)
    clean = codes.float() / 255
    scene = Scene.preset("phone_at_phone").with_shrink((1, 3))
    photos = scene.capture(clean, torch.Generator().manual_seed(0))
    for p in (0.0, 0.5):
        torch.manual_seed(0)
        model = train(p, args.images, args.epochs)
        rates = accuracy(model, clean, labels), accuracy(model, photos, labels)
        print(f"RandomMoire(p={p}): {rates[0]:.0%} clean, {rates[1]:.0%} photographed")


if __name__ == "__main__":
    main()
