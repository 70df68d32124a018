"""Attack your own classifier.

Trains a small network to attack; replace it with yours. Any callable that takes images in [0, 1]
and returns logits will do: `attacks.Normalized` puts the normalisation inside. The Moiré Attack
then adds noise to the camera's raw reading. Its controls are the clean images and the same shots
without noise: only the drop in accuracy from the latter is due to the attacker.

    python examples/attack_your_classifier.py

Prints the accuracy on clean images, photos, and attacked photos by eps. Writes three images, their
photos and the attacked photos as attacked.png. Takes less than a minute on one core.
"""

import argparse
import sys
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torchvision.utils import save_image

from moireaug import Scene, attacks, capture

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the repository, for `training`

from training.data import signs

SCENE = Scene.preset("screen_photo").with_shrink((1, 3))  # images are crops of larger photos
MEAN, STD = (0.5, 0.5, 0.5), (0.25, 0.25, 0.25)


def train(images: Tensor, labels: Tensor, epochs: int) -> nn.Module:
    """Train a small network on images (N, 3, 32, 32) in [0, 1]."""
    layers: list[nn.Module] = []
    for inputs, outputs in ((3, 32), (32, 64), (64, 128)):
        layers += [nn.Conv2d(inputs, outputs, 3, 2, 1), nn.BatchNorm2d(outputs), nn.ReLU()]
    network = nn.Sequential(*layers, nn.Flatten(), nn.Linear(128 * 4 * 4, len(signs.CLASSES)))
    model = attacks.Normalized(network, MEAN, STD)
    optimizer = torch.optim.AdamW(model.parameters(), lr=3e-3, weight_decay=0.05)
    for _ in range(epochs):
        for rows in torch.randperm(len(images)).split(64):
            optimizer.zero_grad()
            F.cross_entropy(model(images[rows]), labels[rows]).backward()
            optimizer.step()
    return model.eval()


@torch.no_grad()
def accuracy(model: nn.Module, images: Tensor, labels: Tensor) -> float:
    """Return the share of images (B, 3, H, W) that a model classifies correctly."""
    return (model(images).argmax(1) == labels).float().mean().item()


def main() -> None:
    """Train, attack, and print what the attack adds to the camera's effect."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--images", type=int, default=2000, help="training images")
    parser.add_argument("--epochs", type=int, default=10)
    parser.add_argument("--attacked", type=int, default=200, help="test images that are attacked")
    parser.add_argument("--steps", type=int, default=20)
    parser.add_argument("--out", default="attacked.png", help="a picture's file")
    args = parser.parse_args()

    Path(args.out).parent.mkdir(parents=True, exist_ok=True)  # before the work
    torch.manual_seed(0)
    codes, labels = signs.make("train", args.images, size=32)
    model = train(codes.float() / 255, labels, args.epochs)

    codes, labels = signs.make("test", args.attacked, size=32)
    images = codes.float() / 255
    shot = SCENE.sample(len(images), (32, 32))
    photos = capture(images, shot)
    print(f"clean images          {accuracy(model, images, labels):.0%}")
    print(f"photos, no noise      {accuracy(model, photos, labels):.0%}")
    for eps in (2, 4, 8):
        attack = attacks.MoireAttack(model, scene=SCENE, eps=eps / 255, steps=args.steps)
        attacked = attack(images, labels, shot=shot).images
        print(f"Moiré Attack {eps}/255    {accuracy(model, attacked, labels):.0%}")
    save_image(torch.cat([images[:3], photos[:3], attacked[:3]]), args.out, nrow=3)


if __name__ == "__main__":
    main()
