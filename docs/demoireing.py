"""Draw docs/demoireing.png: what a demoiréing network removes from simulated photos of a sign.

Run it as `python docs/demoireing.py WEIGHTS`, with the weights.pt of a run of recipe=demoire.
"""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

import torch
from matplotlib.figure import Figure

from moireaug import Scene, capture
from moireaug.defenses import demoire
from moireaug.evaluation.visibility import psnr
from moireaug.synthesis import without_moire
from training.data import signs

SIGN = 9
SCENES = ("screen_photo", "phone_at_phone", "webcam_at_phone", "phone_at_led_wall")
SIDE, SHOWN_SIDE = 256, 128  # pixels of the photo, and of its middle, which is shown
DRAWS = 16  # shots of a scene, of which the one with the strongest moiré is shown
STRONGER = 8  # times, of what was removed


def draw(weights: str) -> None:
    network = demoire.load(weights).eval()
    sign = signs.make("test", 16, SIDE)[0][SIGN, None].float() / 255
    middle = slice((SIDE - SHOWN_SIDE) // 2, (SIDE + SHOWN_SIDE) // 2)
    figure = Figure((10, 2.18 * len(SCENES)), layout="constrained")
    for row, name in zip(figure.subplots(len(SCENES), 5), SCENES, strict=True):
        shots = Scene.preset(name).sample(DRAWS, (SIDE, SIDE), torch.Generator().manual_seed(0))
        photos = capture(sign.expand(DRAWS, -1, -1, -1), shots)
        twins = capture(sign.expand(DRAWS, -1, -1, -1), without_moire(shots))
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
            "original": sign,
            f"removed × {STRONGER}": removed,
        }
        for ax, (title, picture) in zip(row, titles.items(), strict=True):
            ax.imshow(picture[0, :, middle, middle].permute(1, 2, 0), interpolation="nearest")
            ax.set_title(title, fontsize=8)
            ax.axis("off")
    figure.savefig(HERE / "demoireing.png", dpi=100)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    draw(sys.argv[1])
