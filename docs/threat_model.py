"""Print how far noise on the raw reading moves the photo's codes: the table of threat_model.md.

Run it as `python docs/threat_model.py`.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import torch

from moireaug import Develop, Panel, Scene, Sensor, capture

CODES = torch.tensor([0, 128, 255])
# a panel and a sensor that change nothing: what is left is the camera's transfer curve
LINEAR = Scene(
    panel=Panel(layout="even"), sensor=Sensor(cfa="none"), develop=Develop(linear_light=True)
)


def change(eps: float) -> list[float]:
    """Return the largest change of each code, of 255, by noise of either sign at the bound."""
    images = (CODES / 255)[:, None, None, None].expand(-1, 3, 4, 4).contiguous()
    shot = LINEAR.sample(len(CODES), (4, 4), torch.Generator().manual_seed(0))
    moved = []
    for sign in (1.0, -1.0):
        noise = torch.full(shot.raw_shape(), sign * eps)
        moved.append((capture(images, shot, noise) - images).abs().amax((1, 2, 3)))
    return (255 * torch.stack(moved).amax(0)).tolist()


def main() -> None:
    for bound in (2, 4, 8):
        black, grey, white = change(bound / 255)
        print(f"eps {bound}/255: 0 moves by {black:.1f}, 128 by {grey:.1f}, 255 by {white:.1f}")


if __name__ == "__main__":
    main()
