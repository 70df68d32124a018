"""Use RandomMoire with albumentations in a DataLoader of several workers.

The scene leaves photos in the camera's frame, so boxes move with the picture: the box around the
whole picture becomes the box of the screen in the photo, which is what a screen detector needs. The
data set keeps its `A.Compose` as an attribute, where `seed_worker` finds it. Without `seed_worker`,
workers repeat each other's draws, and every epoch repeats the first.

    python examples/albumentations_dataloader.py
    python examples/albumentations_dataloader.py --workers 4

Prints, for each epoch, the share of photographed images, the mean width of their screens, and the
images per second.
"""

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import albumentations as A
import torch
from albumentations.pytorch import ToTensorV2
from torch.utils.data import DataLoader, Dataset

from moireaug import Scene, View
from moireaug.transforms.albumentations import RandomMoire, seed_worker

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the repository, for `training`

from training.data import signs

preset = Scene.preset("phone_at_monitor")
# photos stay in the camera's frame, and are shrunk without averaging, or little moiré is left
develop = replace(preset.develop, registered=False, resize="point")
view = View(yaw=(-20, 20), roll=(-10, 10), zoom=(0.5, 0.9))
SCENE = replace(preset, view=view, develop=develop)


class Screens(Dataset):
    """Drawn signs, half photographed off a screen, and the box of the picture in each."""

    def __init__(self, n: int, size: int) -> None:
        images, _ = signs.make("train", n, size)
        self.images = images.permute(0, 2, 3, 1).numpy()  # (H, W, 3) uint8
        moire = RandomMoire(scene=SCENE, p=0.5)
        boxes = A.BboxParams(format="pascal_voc", label_fields=["labels"])
        steps = [moire, A.RandomBrightnessContrast(p=0.5), A.Normalize(), ToTensorV2()]
        self.transform = A.Compose(steps, bbox_params=boxes, seed=0)

    def __len__(self) -> int:
        return len(self.images)

    def __getitem__(self, index: int) -> tuple[torch.Tensor, torch.Tensor]:
        image = self.images[index]
        whole = [[0, 0, image.shape[1], image.shape[0]]]
        found = self.transform(image=image, bboxes=whole, labels=[0])
        return found["image"], torch.as_tensor(found["bboxes"][0], dtype=torch.float32)


def main() -> None:
    """Load two epochs."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--images", type=int, default=256)
    parser.add_argument("--size", type=int, default=64, help="side of the images, in pixels")
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args()

    torch.manual_seed(0)
    screens = Screens(args.images, args.size)
    workers = {"num_workers": args.workers, "persistent_workers": args.workers > 0}
    loader = DataLoader(screens, 32, worker_init_fn=seed_worker, **workers)
    for epoch in range(2):
        began = time.perf_counter()
        boxes = torch.cat([boxes for _, boxes in loader])
        rate = len(boxes) / (time.perf_counter() - began)
        widths = boxes[:, 2] - boxes[:, 0]
        widths = widths[widths < args.size]  # of the photographed ones
        share, width = f"{len(widths) / len(boxes):.0%} photographed", f"{widths.mean():.2f} px"
        print(f"epoch {epoch}: {share}, their screens {width} wide; {rate:.0f} images per second")


if __name__ == "__main__":
    main()
