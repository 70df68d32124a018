"""Augment batches on the GPU with kornia.

Puts `RandomMoire` into kornia's `AugmentationSequential`, which augments a whole batch on its
device: images from the loader are moved to the device once, and masks follow the geometric part of
the pipeline. Runs on the CPU if there is no GPU.

    python examples/kornia_on_the_gpu.py
    python examples/kornia_on_the_gpu.py --batch 256 --size 224

Prints the pipeline, the device, the images per second, and whether a replay gives the same pixels.
Takes a few seconds on the CPU.
"""

import argparse
import sys
import time
from pathlib import Path

import torch
from kornia.augmentation import AugmentationSequential, ColorJitter, RandomAffine

from moireaug.transforms.kornia import RandomMoire

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the repository, for `training`

from training.data import signs


def main() -> None:
    """Augment some batches and time them."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--size", type=int, default=64, help="side of the images, in pixels")
    parser.add_argument("--batches", type=int, default=5)
    args = parser.parse_args()
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    torch.manual_seed(0)

    augment = AugmentationSequential(
        RandomAffine(degrees=10.0, translate=(0.05, 0.05), p=0.5),
        RandomMoire(scene="screen_photo", p=0.5, shrink=(1, 3)),  # computes the chosen rows only
        ColorJitter(brightness=0.1, p=0.5),
        data_keys=["input", "mask"],
    )
    print(augment)

    codes, _ = signs.make("train", args.batch, size=args.size)
    images = codes.to(device).float() / 255
    masks = (images.mean(1, keepdim=True) > 0.5).float()  # what a segmentation would learn

    augment(images, masks)  # the first call compiles or warms up
    began = time.perf_counter()
    for _ in range(args.batches):
        photos, moved = augment(images, masks)
    if device.type == "cuda":
        torch.cuda.synchronize()
    seconds = time.perf_counter() - began
    rate = args.batches * args.batch / seconds
    print(f"{device}: {rate:.0f} images of {args.size} px per second")

    again, _ = augment(images, masks, params=augment._params)
    print(f"Replaying the parameters gives the same pixels: {torch.equal(photos, again)}")
    print(f"Masks still contain only 0 and 1: {sorted(moved.unique().tolist()) == [0.0, 1.0]}")


if __name__ == "__main__":
    main()
