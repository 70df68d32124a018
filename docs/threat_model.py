"""Draw docs/threat_model.png: how far noise on the raw reading moves the codes of the photo.

Run it as `python docs/threat_model.py`.
"""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

import torch
from matplotlib.figure import Figure

from moireaug import Develop, Panel, Scene, Sensor, capture

CODES = torch.arange(256) / 255
BOUNDS = {
    "2/255": (2 / 255, "#56B4E9"),
    "4/255": (4 / 255, "#0072B2"),
    "8/255": (8 / 255, "#D55E00"),
}
# a panel and a sensor that change nothing: what is left is the camera's transfer curve
LINEAR = Scene(
    panel=Panel(layout="even"), sensor=Sensor(cfa="none"), develop=Develop(linear_light=True)
)
ON_CODES = Scene(panel=Panel(layout="even"), sensor=Sensor(cfa="none"))


def change(scene: Scene, eps: float) -> torch.Tensor:
    """Return the largest change of each code, of 255, by noise of either sign at the bound."""
    images = CODES[:, None, None, None].expand(-1, 3, 4, 4).contiguous()
    shot = scene.sample(256, (4, 4), torch.Generator().manual_seed(0))
    moved = []
    for sign in (1.0, -1.0):
        noise = torch.full(shot.raw_shape(), sign * eps)
        moved.append((capture(images, shot, noise) - images).abs().amax((1, 2, 3)))
    return 255 * torch.stack(moved).amax(0)


def main() -> None:
    figure = Figure(figsize=(7.2, 3.6), layout="constrained", facecolor="white")
    ax = figure.subplots()
    for name, (eps, colour) in BOUNDS.items():
        ax.plot(range(256), change(LINEAR, eps), color=colour, label=f"eps {name}, linear light")
        ax.plot(range(256), change(ON_CODES, eps), color=colour, linestyle=":", linewidth=1.2)
    ax.plot([], [], color="#555555", linestyle=":", label="the same in a scene on codes")
    ax.set(xlim=(0, 255), ylim=(0, None))
    ax.set_xlabel("code of the screen, of 255")
    ax.set_ylabel("largest change of the photo, codes")
    ax.grid(color="#DDDDDD", linewidth=0.7)
    ax.spines[["top", "right"]].set_visible(False)
    ax.legend(frameon=False)
    figure.savefig(HERE / "threat_model.png", dpi=110, pil_kwargs={"optimize": True})
    for name, (eps, _) in BOUNDS.items():
        moved = change(LINEAR, eps)
        black, grey, white = (float(moved[code]) for code in (0, 128, 255))
        print(f"eps {name}: 0 moves by {black:.1f}, 128 by {grey:.1f}, 255 by {white:.1f}")


if __name__ == "__main__":
    main()
