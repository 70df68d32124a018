"""Draw docs/hard_cases.png: the photo of every case of tests/test_hard_cases.py, by its name.

Run it as `python docs/hard_cases.py`.
"""

from __future__ import annotations

import runpy
import sys
import textwrap
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

import torch
from gallery import photograph
from matplotlib.figure import Figure

from moireaug import Scene, capture

SIDE = 96  # of the photograph
COLUMNS = 8
TITLE_WIDTH = 18  # characters in a line


def main() -> None:
    cases: dict[str, Scene] = runpy.run_path(str(HERE.parent / "tests/test_hard_cases.py"))["CASES"]
    picture = photograph(SIDE)[None]
    rows = -(-len(cases) // COLUMNS)
    figure = Figure(figsize=(1.3 * COLUMNS, 1.6 * rows), dpi=100, layout="constrained")
    axes = figure.subplots(rows, COLUMNS).flat
    for axis, (name, scene) in zip(axes, cases.items(), strict=False):
        shot = scene.sample(1, (SIDE, SIDE), torch.Generator().manual_seed(1))
        photo = capture(picture, shot)[0]
        axis.imshow(photo.permute(1, 2, 0).numpy(), interpolation="nearest", vmin=0, vmax=1)
        axis.set_title(textwrap.fill(name, TITLE_WIDTH), fontsize=8)
    for axis in figure.axes:
        axis.set_axis_off()
    figure.savefig(HERE / "hard_cases.png", pil_kwargs={"optimize": True})


if __name__ == "__main__":
    main()
