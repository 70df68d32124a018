"""The problems on which exposure methods are compared: a picture, on a panel, in front of a
camera."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import matplotlib.cbook
import torch
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor
from torchvision.transforms.v2.functional import pil_to_tensor

from moireaug import Lens, Panel, Scene, Sensor, View

VIEWS = {
    # exactly frontal, all rows of an aperture's points would meet the subpixels' edges in step, as
    # in no real photo
    "frontal": View(roll=0.7),
    "oblique": View(yaw=25, pitch=-10, roll=5),
}
LINES = """moiré on a screen is
the alias of stripes
with a Bayer lattice;
small print shows it
and so do thin rules
"""


@dataclass(frozen=True)
class Problem:
    """A picture and a scene of plain numbers, so that every image of a batch has the same geometry.

    Args:
        picture: a key of `PICTURES`.
        pitch: sensor pixels per panel pixel, if the view were frontal and edge to edge.
        view: a key of `VIEWS`.
        scene: all of it, with the exposure "auto".
    """

    picture: str
    pitch: float
    view: str
    scene: Scene

    @property
    def title(self) -> str:
        lens = self.scene.lens
        extras = (", no blur" if lens.blur == 0 else "") + (f", k1 {lens.k1:g}" if lens.k1 else "")
        return (
            f"{self.picture}, {self.scene.panel.layout}, pitch {self.pitch:g}, {self.view}{extras}"
        )

    def side(self, sensor_pixels: int) -> int:
        """Photo pixels along each axis, so that all problems read about as many sensor pixels."""
        return round(sensor_pixels / self.scene.sensor.scale)


def problem(
    picture: str,
    layout: str,
    pitch: float,
    view: str,
    *,
    panel: float,
    blur: float = 0.3,
    k1: float = 0.0,
) -> Problem:
    """Return a problem; `panel` is in panel pixels per image pixel. Codes are light, and there is
    no noise."""
    scene = Scene(
        panel=Panel(scale=panel, layout=layout),
        view=VIEWS[view],
        lens=Lens(blur=blur, k1=k1),
        sensor=Sensor(scale=pitch * panel),
    )
    return Problem(picture, pitch, view, scene)


# text is always shown with one panel pixel per image pixel, as on real screens
PROBLEMS = (
    dict(picture="grey", layout="rgb_stripe", pitch=0.4, view="frontal", panel=5),
    dict(picture="photo", layout="rgb_stripe", pitch=0.7, view="oblique", panel=3),
    dict(picture="grey", layout="rgb_stripe", pitch=1, view="frontal", panel=2),
    dict(picture="photo", layout="led", pitch=1, view="oblique", panel=2, k1=0.04),
    dict(picture="photo", layout="rgb_stripe", pitch=1.4, view="oblique", panel=1.5, k1=-0.03),
    dict(picture="text", layout="pentile", pitch=1.4, view="frontal", panel=1),
    dict(picture="grey", layout="rgb_stripe", pitch=2, view="oblique", panel=1, blur=0),
    dict(picture="text", layout="rgb_stripe", pitch=2, view="oblique", panel=1),
    dict(picture="photo", layout="rgb_column", pitch=3, view="oblique", panel=1),
    dict(picture="text", layout="rgb_stripe", pitch=3, view="frontal", panel=1, k1=0.04),
    dict(picture="text", layout="rgb_stripe", pitch=4, view="oblique", panel=1),
    dict(picture="grey", layout="led", pitch=6, view="frontal", panel=1),
)


def grey(n: int, side: int) -> Iterator[Image.Image]:
    """Flat, 0.7 of full scale: whatever varies in its photo is due to the panel."""
    return (Image.new("RGB", (side, side), (178, 179, 178)) for _ in range(n))


def photo(n: int, side: int) -> Iterator[Image.Image]:
    """Parts of Grace Hopper's portrait, which comes with matplotlib."""
    with Image.open(matplotlib.cbook.get_sample_data("grace_hopper.jpg", asfileobj=False)) as whole:
        for i in range(n):
            left, top = 40 + 60 * (i % 4), 30 + 110 * (i // 4 % 3)
            yield whole.resize(
                (side, side), Image.Resampling.LANCZOS, box=(left, top, left + 224, top + 224)
            )


def text(n: int, side: int) -> Iterator[Image.Image]:
    """Black on white, 10 pixels high."""
    font = ImageFont.load_default(size=10)
    for i in range(n):
        page = Image.new("RGB", (side, side), "white")
        ImageDraw.Draw(page).multiline_text(
            (2 - 11 * i, 1), 4 * LINES, fill="black", font=font, spacing=2
        )
        yield page


PICTURES = {"grey": grey, "photo": photo, "text": text}


def images(picture: str, n: int, side: int) -> Tensor:
    """Return n pictures, (n, 3, side, side) float32 in [0, 1]."""
    return torch.stack([pil_to_tensor(image) for image in PICTURES[picture](n, side)]) / 255
