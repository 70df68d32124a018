"""Draw docs/gallery.png: every preset, on signs and on a grey screen.

python docs/gallery.py
"""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

import torch
from matplotlib.figure import Figure

from moireaug.presets import PRESETS
from training import signs

SIZE, COLUMNS = 160, 5


def main() -> None:
    drawn, _ = signs.make("test", 32, size=SIZE, seed=4)
    grey = torch.full((1, 3, SIZE, SIZE), 0.75)
    images = torch.cat([drawn[[3, 9, 17, 24]].float() / 255, grey])
    rows = {"shown on the screen": images}
    for name, scene in PRESETS.items():
        rows[name] = scene.capture(images, torch.Generator().manual_seed(3))
    figure = Figure(figsize=(COLUMNS * 1.6 + 1.7, len(rows) * 1.6), dpi=90, layout="constrained")
    axes = figure.subplots(len(rows), COLUMNS)
    for line, (name, photos) in zip(axes, rows.items(), strict=True):
        for axis, photo in zip(line, photos, strict=True):
            axis.imshow(photo.permute(1, 2, 0).numpy(), interpolation="nearest")
            axis.set(xticks=[], yticks=[])
            axis.spines[:].set_visible(False)
        line[0].set_ylabel(name.replace("_at_", "\nat ").replace("_", " "), rotation=0, ha="right", va="center")
    figure.savefig(HERE / "gallery.png", pil_kwargs={"optimize": True})


if __name__ == "__main__":
    main()
