"""Make pairs of photos and originals, and train a network that removes the moiré.

`Pairs` photographs random crops from a folder of pictures, endlessly. The target here is the twin:
the same photo without moiré, which no camera can take. It teaches the network to remove only moiré.

    python examples/train_a_demoireing_network.py
    python examples/train_a_demoireing_network.py --pictures DIR --crop 256 --steps 50000

Prints the PSNR of held-out photos against their twins, as taken and cleaned. Writes the weights to
demoire.pt and three examples to demoired.png. Takes about two minutes on one core.
"""

import argparse
import itertools
import tempfile
from pathlib import Path

import torch
from PIL import Image
from skimage import data
from torch import Tensor
from torch.utils.data import DataLoader
from torchvision.utils import save_image

from moireaug import Develop, Lens, Panel, Scene, Sensor, View
from moireaug.defenses import demoire
from moireaug.synthesis import Pairs

PICTURE_NAMES = ("astronaut", "chelsea", "coffee", "rocket", "immunohistochemistry")
SCENE = Scene(  # a sharp lens and a panel it barely resolves: strong moiré
    panel=Panel(scale=(0.9, 1.2)), view=View(yaw=(-15, 15), roll=(-8, 8)), lens=Lens(blur=0.25),
    sensor=Sensor(scale=2, gain=(2.4, 3.0)), develop=Develop(linear_light=True),
)  # fmt: skip


def psnr(images: Tensor, targets: Tensor) -> float:
    """Return the mean PSNR of images (B, 3, H, W) in [0, 1], in dB."""
    return -10 * (images - targets).square().mean((1, 2, 3)).log10().mean().item()


def main() -> None:
    """Train on pairs with one seed, test on pairs with another."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--pictures", help="a folder of pictures; scikit-image's if left out")
    parser.add_argument("--crop", type=int, default=64, help="side of the crops, in pixels")
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--width", type=float, default=0.25)
    parser.add_argument("--out", default=".", help="a folder")
    args = parser.parse_args()
    Path(args.out).mkdir(parents=True, exist_ok=True)  # before the work
    torch.manual_seed(0)
    with tempfile.TemporaryDirectory() as made:
        if args.pictures is None:
            for name in PICTURE_NAMES:
                Image.fromarray(getattr(data, name)()).save(Path(made) / f"{name}.png")
        folder = args.pictures or made
        pairs = Pairs(folder, SCENE, args.crop, twin=True, seed=0)
        held_out = Pairs(folder, SCENE, args.crop, twin=True, seed=1, n=16)

        network = demoire.build("esdnet", width=args.width)
        optimizer = torch.optim.Adam(network.parameters(), lr=1e-3)
        for batch in itertools.islice(DataLoader(pairs, batch_size=4), args.steps):
            loss = demoire.losses.esdnet(network.outputs(batch["photo"]), batch["twin"])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
        test = next(iter(DataLoader(held_out, batch_size=16)))

    demoire.save(network, Path(args.out) / "demoire.pt")
    cleaner = demoire.Demoire(demoire.load(Path(args.out) / "demoire.pt"))  # a defence, too
    with torch.no_grad():
        cleaned = cleaner(test["photo"])
    print(f"PSNR to the photo without moiré: {psnr(test['photo'], test['twin']):.2f} dB as taken")
    print(f"                                 {psnr(cleaned, test['twin']):.2f} dB cleaned")
    shown = torch.cat([test["photo"][:3], cleaned[:3], test["twin"][:3]])
    save_image(shown, Path(args.out) / "demoired.png", nrow=3)


if __name__ == "__main__":
    main()
