"""Draw docs/demoireing.png: what a demoiréing network removes from simulated photos.

Run it as `python docs/demoireing.py WEIGHTS`: a weights.pt, or "screen", the released weights.
"""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

import numpy as np
import torch
from matplotlib.figure import Figure
from torchvision.transforms.functional import to_tensor

from moireaug import Scene, capture
from moireaug.defenses import demoire
from moireaug.evaluation.visibility import psnr
from moireaug.synthesis import without_moire
from training.data import drawn_pictures

# what is photographed, and where
PICTURES = {
    "dead leaves": "screen_photo",
    "page": "phone_at_monitor",
    "sign": "phone_at_phone",
    "interface": "phone_at_led_wall",
}
SIDE, SHOWN_SIDE = 256, 160  # pixels of the photo, and of its middle, which is shown
SHRINK = (1, 3)  # sensor pixels per pixel of the photo, which is a crop
DRAWS = 32  # shots of a scene, of which the one with the strongest moiré is shown
STRONGER = 4  # times, of what was removed


def draw(weights: str) -> None:
    network = demoire.load(weights).eval()
    middle = slice((SIDE - SHOWN_SIDE) // 2, (SIDE + SHOWN_SIDE) // 2)
    figure = Figure((10, 2.18 * len(PICTURES)), layout="constrained")
    rows = figure.subplots(len(PICTURES), 5)
    for row, (kind, name) in zip(rows, PICTURES.items(), strict=True):
        render, _ = drawn_pictures.KINDS[kind]
        picture = to_tensor(render(np.random.default_rng(1), SIDE))[None]
        scene = Scene.preset(name).with_shrink(SHRINK)
        shots = scene.sample(DRAWS, (SIDE, SIDE), torch.Generator().manual_seed(0))
        photos = capture(picture.expand(DRAWS, -1, -1, -1), shots)
        twins = capture(picture.expand(DRAWS, -1, -1, -1), without_moire(shots))
        strongest = int(psnr(photos, twins).argmin())
        photo, twin = photos[strongest, None], twins[strongest, None]
        with torch.inference_mode():
            cleaned = network(photo)
        before, after = (psnr(x, twin).item() for x in (photo, cleaned))
        removed = (0.5 + STRONGER * (photo - cleaned)).clamp(0, 1)
        titles = {
            f"{name}\nphoto, {before:.1f} dB": photo,
            f"cleaned, {after:.1f} dB": cleaned,
            "twin: no moiré": twin,
            "original": picture,
            f"removed × {STRONGER}": removed,
        }
        for ax, (title, image) in zip(row, titles.items(), strict=True):
            ax.imshow(image[0, :, middle, middle].permute(1, 2, 0), interpolation="nearest")
            ax.set_title(title, fontsize=8)
            ax.axis("off")
    figure.savefig(HERE / "demoireing.png", dpi=100)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    draw(sys.argv[1])
