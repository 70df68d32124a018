"""Draw docs/effects.png, every effect by itself.

Run it as `python docs/effects.py`.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

import torch
from matplotlib.figure import Figure
from torch import Tensor

from moireaug import Develop, Layout, Lens, Panel, Scene, Sensor, View
from moireaug.scene.layout import LAYOUTS
from training.data import signs

SIZE = 160  # of the effects' picture
COLUMNS = 6

# A sharp camera in front of a panel whose stripes it resolves badly: moiré without anything else.
MOIRE = Scene(
    panel=Panel(scale=1.15), view=View(yaw=8, pitch=-5, roll=3), lens=Lens(blur=0.25),
    sensor=Sensor(scale=2, gain=2.8), develop=Develop(linear_light=True),
)  # fmt: skip
# A panel that emits evenly and a sensor without filters: nothing happens except what a scene adds.
PLAIN = Scene(panel=Panel(layout="even"), sensor=Sensor(cfa="none"))
# Panel pixels 16 sensor pixels wide: the subpixels themselves.
CLOSE = Scene(panel=Panel(scale=1 / 16), lens=Lens(blur=0.3), sensor=Sensor(cfa="none", gain=2.5))

OWN_LAYOUT = Layout(((0, 0, 0, 0.5, 1), (1, 0.5, 0, 1, 0.5), (2, 0.5, 0.5, 1, 1)))


def close(layout: str | Layout, gain: float = 2.5, **panel: float) -> Scene:
    return replace(
        CLOSE,
        panel=replace(CLOSE.panel, layout=layout, **panel),
        sensor=replace(CLOSE.sensor, gain=gain),
    )


def moire(**parts: dict[str, object]) -> Scene:
    return replace(
        MOIRE, **{name: replace(getattr(MOIRE, name), **fields) for name, fields in parts.items()}
    )


FLICKER = {
    "panel": {"pwm": 240.0, "duty": 0.4, "phase": 0.2},
    "sensor": {"shutter": 1 / 500, "readout": 1 / 40},
}
EFFECTS: dict[str, Scene] = {
    "no effect:\nthe image, bit for bit": PLAIN,
    **{
        f"layout {name},\nmagnified 16 times": close(name)
        for name in LAYOUTS
        if name not in ("bgr_stripe", "even")
    },
    "layout even,\nmagnified 16 times": close("even", gain=1.0),
    "rgb_stripe, 40 % of each\nsubpixel lit": close("rgb_stripe", lit=0.4),
    "a unit cell of one's own": close(OWN_LAYOUT),
    "layout: moiré of the stripes": MOIRE,
    "exposure point, as the paper:\nmuch more than a lens passes": moire(
        sensor={"exposure": "point"}
    ),
    "exposure mean:\nthe same camera, no moiré": moire(sensor={"exposure": "mean"}),
    "black matrix, 80 % of width and\n60 % of height lit: a lattice": moire(
        panel={"lit_x": 0.8, "lit_y": 0.6}
    ),
    "black level 0.1": replace(PLAIN, panel=Panel(layout="even", black=0.1)),
    "glare 0.4, more of it\nat the right": replace(
        PLAIN,
        panel=Panel(layout="even", glare=0.4, glare_x=0.5),
        sensor=Sensor(cfa="none", gain=0.7),
    ),
    "crosstalk 0.25, undone by\nthe colour matrix": moire(sensor={"crosstalk": 0.25}),
    "motion along a diagonal, 2 px": replace(PLAIN, lens=Lens(motion_x=2.0, motion_y=2.0)),
    "lens blur 0.6 px:\nthe moiré fades": moire(lens={"blur": 0.6}),
    "low-pass filter, 1 px apart": moire(lens={"olpf": 1.0}),
    "yaw 45, not registered": replace(
        PLAIN,
        view=View(yaw=45),
        develop=Develop(registered=False),
        sensor=Sensor(cfa="none", scale=2),
    ),
    "the same, registered": replace(PLAIN, view=View(yaw=45), sensor=Sensor(cfa="none", scale=2)),
    "lens k1 0.25, not registered": replace(
        PLAIN, lens=Lens(k1=0.25), develop=Develop(registered=False)
    ),
    "vignetting 0.6": replace(PLAIN, lens=Lens(vignetting=0.6)),
    "prefilter: seen from afar,\nzoom 0.2 and registered": replace(PLAIN, view=View(zoom=0.2)),
    "flicker: 240 Hz, 40 % on,\nrolling shutter": moire(**FLICKER),
    "gain 6: overexposed": moire(sensor={"gain": 6.0}),
    "read noise 0.05": replace(PLAIN, sensor=Sensor(cfa="none", read_noise=0.05)),
    "shot noise 0.15:\ngrows with the light": replace(
        PLAIN, sensor=Sensor(cfa="none", shot_noise=0.15)
    ),
    "2 bits": replace(PLAIN, sensor=Sensor(cfa="none", bits=2)),
    "Bayer, bilinear, 1 sensor\npixel a photo pixel": replace(PLAIN, sensor=Sensor()),
    "Bayer, Malvar:\nsharper": replace(PLAIN, sensor=Sensor(), develop=Develop(demosaic="malvar")),
    "white balance: red 1.3, blue 0.7": replace(PLAIN, develop=Develop(red=1.3, blue=0.7)),
    "saturation 1.8": replace(PLAIN, develop=Develop(saturation=1.8)),
    "shoulder 3: highlights\nrolled off": replace(PLAIN, develop=Develop(shoulder=3.0)),
    "contrast 0.9": replace(PLAIN, develop=Develop(contrast=0.9)),
    "chroma blur 4 px:\nbrightness stays": replace(PLAIN, develop=Develop(chroma_blur=4.0)),
    "unsharp mask of 2": replace(PLAIN, develop=Develop(sharpen=2.0, sharpen_radius=1.5)),
    "brighten 0.25": replace(PLAIN, develop=Develop(brighten=0.25)),
    "noise, then non-local means": replace(
        PLAIN, sensor=Sensor(cfa="none", read_noise=0.02), develop=Develop(denoise="nlm")
    ),
    "noise, then bilateral": replace(
        PLAIN, sensor=Sensor(cfa="none", read_noise=0.05), develop=Develop(denoise="bilateral")
    ),
    "JPEG, quality 10": replace(PLAIN, develop=Develop(jpeg=10)),
}


def main() -> None:
    drawn, _ = signs.make("test", 32, size=SIZE, seed=4)
    image = drawn[9].float() / 255
    photos = {}
    for caption, scene in EFFECTS.items():
        photos[caption] = scene.capture(image[None], torch.Generator().manual_seed(3))[0]
    draw(photos)


def draw(photos: dict[str, Tensor]) -> None:
    """Draw every effect's photo under its caption."""
    rows = -(-len(photos) // COLUMNS)
    figure = Figure(figsize=(COLUMNS * 2.05, rows * 2.3), dpi=90, layout="constrained")
    axes = figure.subplots(rows, COLUMNS)
    for axis in axes.flat:
        axis.set_axis_off()
    for axis, (caption, photo) in zip(axes.flat, photos.items(), strict=False):
        axis.imshow(photo.permute(1, 2, 0).numpy(), interpolation="nearest", vmin=0, vmax=1)
        axis.set_title(caption, fontsize=8)
    figure.savefig(HERE / "effects.png", pil_kwargs={"optimize": True})


if __name__ == "__main__":
    main()
