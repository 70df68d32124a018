"""Draw docs/pairs.png: a pair, its twin without moiré, and the moiré that tells them apart.

Run it as `python docs/pairs.py`.
"""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

import torch
from matplotlib import cbook
from matplotlib.figure import Figure
from PIL import Image
from torchvision.transforms.v2.functional import pil_to_tensor

from moireaug import Scene, capture
from moireaug.synthesis import without_moire

SIZE = 192
SHOWN_DRAWS = (3, 4)  # of eight: strong and medium moiré; others have hardly any


def crop() -> torch.Tensor:
    """Return a part of matplotlib's sample photograph, which is in the public domain,
    (1, 3, SIZE, SIZE)."""
    with cbook.get_sample_data("grace_hopper.jpg") as file:
        picture = Image.open(file).convert("RGB").crop((160, 60, 160 + SIZE, 60 + SIZE))
    return pil_to_tensor(picture)[None] / 255


def main() -> None:
    scene = Scene.preset("phone_at_monitor")
    shots = scene.sample(8, (SIZE, SIZE), torch.Generator().manual_seed(3))
    shot = shots[torch.tensor(SHOWN_DRAWS)]
    original = crop().expand(len(shot), -1, -1, -1).contiguous()
    photo, twin = capture(original, shot), capture(original, without_moire(shot))
    pictures = {
        "original": original,
        "photo": photo,
        "twin": twin,
        "photo - twin, 3 times": 0.5 + 3 * (photo - twin),
    }
    figure = Figure(figsize=(4 * 2.2, 2 * 2.25), dpi=90, layout="constrained", facecolor="white")
    axes = figure.subplots(len(shot), len(pictures), squeeze=False)
    for column, (name, batch) in zip(axes.T, pictures.items(), strict=True):
        column[0].set_title(name)
        for axis, picture in zip(column, batch, strict=True):
            axis.imshow(picture.permute(1, 2, 0).clamp(0, 1).numpy(), interpolation="nearest")
            axis.set(xticks=[], yticks=[])
            axis.spines[:].set_visible(False)
    figure.savefig(HERE / "pairs.png", pil_kwargs={"optimize": True})


if __name__ == "__main__":
    main()
