"""Is text on screens read from its photos? Pages and interfaces in several sizes of type, whole and
as crops, in every preset of "anywhere", read by RapidOCR; the same without moiré, and after the
released demoiréing network has cleaned them.

    pip install --no-deps rapidocr-onnxruntime      # which would bring a second OpenCV
    pip install onnxruntime pyclipper shapely six
    python benchmarks/text.py             # minutes; writes results/text.csv and docs/text.png
    python benchmarks/text.py --quick

The character error rate is the edit distance between what was written and what is read, over the
number of characters, of each picture at most 1. Spaces do not count: the reader drops many of them.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
import pandas as pd
import torch
from matplotlib.figure import Figure
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor
from torchmetrics.functional.text import char_error_rate

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

from benchmarks import measure
from benchmarks.codes import WHOLE_PHOTO
from moireaug import capture
from moireaug.defenses import demoire
from moireaug.defenses.demoire import DemoireNet
from moireaug.mixtures import as_scenes, scenes_of
from moireaug.scene.presets import MIXTURES
from moireaug.synthesis import without_moire

FONTS = Path(matplotlib.get_data_path()) / "fonts/ttf"  # DejaVu, in matplotlib's wheel
COMMON_WORDS = """
the of and to in is you that it he was for on are as with his they at be this have from or
one had by word but not what all were we when your can said there use an each which she do
how their if will up other about out many then them these so some her would make like him
into time has look two more write go see number no way could people my than first water
been call who oil its now find long down day did get come made may part over new sound
take only little work know place year live me back give most very after thing our just
name good man
"""
WORDS = COMMON_WORDS.split()
KINDS = ("page", "interface")
# background, ink and box of interfaces, in codes
COLOURS = (
    ((250, 250, 250), (20, 20, 20), (225, 235, 250)),
    ((30, 32, 40), (230, 230, 230), (60, 70, 95)),
)


@dataclass(frozen=True)
class Sizes:
    """What is photographed and how often."""

    side: int = 256  # pixels of a picture
    types: tuple[int, ...] = (10, 16, 26)  # pixels of type, from ascender to descender
    shrinks: tuple[float | str, ...] = (1.0, WHOLE_PHOTO)
    presets: tuple[str, ...] = MIXTURES["anywhere"]
    shots: int = 4  # half of pages, half of interfaces
    cleaned: tuple[float | str, ...] = (1.0,)  # shrinks whose photos are cleaned, too


QUICK_SETTINGS = Sizes(128, (20,), (WHOLE_PHOTO,), ("screen_photo",), 2, (WHOLE_PHOTO,))


class Page(NamedTuple):
    """A picture (3, side, side) in [0, 1], and its text line by line, without spaces."""

    picture: Tensor
    text: str


def drawn(kind: str, size: int, side: int, seed: int) -> Page:
    """Draw lines of words on a "page", or short ones on the boxes of an "interface"."""
    rng = np.random.default_rng([seed, size, len(kind)])
    dark = kind == "interface" and rng.random() < 0.5
    paper, ink, box = COLOURS[dark]
    canvas = Image.new("RGB", (side, side), paper)
    pen, font = ImageDraw.Draw(canvas), ImageFont.truetype(FONTS / "DejaVuSans.ttf", size)
    spacing = round(size * (1.35 if kind == "page" else 2.0))
    lines = []
    for top in range(size // 2, side - spacing, spacing):
        width = side - size if kind == "page" else rng.uniform(0.4, 0.8) * side
        line = str(rng.choice(WORDS)).capitalize()
        while pen.textlength(longer := f"{line} {_word(rng)}", font) < width:
            line = longer
        if kind == "interface":
            right = size // 2 + pen.textlength(line, font) + size // 2
            pen.rounded_rectangle((size // 4, top - size // 4, right, top + 1.4 * size), 4, box)
        pen.text((size // 2, top), line, ink, font)
        lines.append(line)
    picture = torch.from_numpy(np.array(canvas)).permute(2, 0, 1).float() / 255
    return Page(picture, without_spaces("".join(lines)))


def pages_of(size: int, sizes: Sizes) -> list[Page]:
    """Return pages and interfaces in turn, of one size of type."""
    kinds = KINDS * (sizes.shots // len(KINDS))
    return [drawn(kind, size, sizes.side, seed) for seed, kind in enumerate(kinds)]


def _word(rng: np.random.Generator) -> str:
    return str(rng.integers(10, 10000)) if rng.random() < 0.1 else str(rng.choice(WORDS))


def without_spaces(text: str) -> str:
    return "".join(text.split())


@cache
def reader(side: int) -> Any:
    """Return RapidOCR, which searches pictures of this side at their own size."""
    from rapidocr_onnxruntime import RapidOCR  # no requirement of what only draws

    threads = {"intra_op_num_threads": 1, "inter_op_num_threads": 1}
    return RapidOCR(det_limit_side_len=side, det_limit_type="min", use_cls=False, **threads)


def read(photo: np.ndarray) -> str:
    """Return the text that is read from a photo (H, W, 3) uint8 RGB, without spaces."""
    lines, _ = reader(min(photo.shape[:2]))(np.ascontiguousarray(photo[..., ::-1]))
    return without_spaces("".join(line[1] for line in lines or []))


def errors(photos: Tensor, texts: list[str]) -> list[float]:
    """Return the character error rates of photos (B, 3, H, W)."""
    arrays = (255 * photos.clamp(0, 1)).round().byte().permute(0, 2, 3, 1).numpy()
    rates = []
    for photo, text in zip(arrays, texts, strict=True):
        rates.append(min(1.0, float(char_error_rate(read(photo), text))))
    return rates


@torch.no_grad()
def rows_of(preset: str, shrink: float | str, sizes: Sizes, clean: DemoireNet) -> list[dict]:
    """Return the error rates of photos, twins and cleaned photos, of every size of type."""
    (scene,) = scenes_of(as_scenes(preset, None if shrink == WHOLE_PHOTO else shrink))
    rows = []
    for size in sizes.types:
        pages = pages_of(size, sizes)
        images = torch.stack([page.picture for page in pages])
        shot = scene.sample(len(pages), (sizes.side,) * 2, torch.Generator().manual_seed(0))
        photos = capture(images, shot)
        shown = {"photo": photos, "twin": capture(images, without_moire(shot))}
        if shrink in sizes.cleaned:
            shown["cleaned"] = clean(photos)
        facts = {"preset": preset, "shrink": shrink, "type": size}
        rows += [facts | row for row in rows_of_states(shown, pages)]
    return rows


def rows_of_pictures(sizes: Sizes) -> list[dict]:
    """Return the error rates of the pictures themselves."""
    rows = []
    for size in sizes.types:
        pages = pages_of(size, sizes)
        shown = {"picture": torch.stack([page.picture for page in pages])}
        facts = {"preset": "", "shrink": "", "type": size}
        rows += [facts | row for row in rows_of_states(shown, pages)]
    return rows


def rows_of_states(shown: dict[str, Tensor], pages: list[Page]) -> list[dict]:
    """Return the error rates of pictures (B, 3, H, W) of pages by their state."""
    rows = []
    for state, pictures in shown.items():
        rates = errors(pictures, [page.text for page in pages])
        row = {"state": state, "n": len(rates), "error": np.mean(rates), "std": np.std(rates)}
        rows.append(row)
    return rows


def plot(table: pd.DataFrame, path: Path) -> None:
    """Draw the error rate against the size of type, over all presets."""
    shrinks = [shrink for shrink in table["shrink"].unique() if shrink != ""]
    figure = Figure(figsize=(3 * len(shrinks) + 1, 3), layout="constrained")
    panels = figure.subplots(1, len(shrinks), sharey=True, squeeze=False)[0]
    styles = {
        "photo": ("o-", "C0", "photo"),
        "cleaned": ("s:", "C1", "photo, demoiréd"),
        "twin": ("--", "C2", "photo without moiré"),
        "picture": ("-", "k", "the picture itself"),
    }
    for panel, shrink in zip(panels, shrinks, strict=True):
        for state, (style, colour, label) in styles.items():
            chosen = table[(table["state"] == state) & table["shrink"].isin([shrink, ""])]
            if len(chosen):
                means = 100 * chosen.groupby("type")["error"].mean()
                panel.plot(means.index, means, style, color=colour, label=label, markersize=4)
        title = "whole photos"
        if shrink != WHOLE_PHOTO:
            title = f"crops, {float(shrink):g} x {float(shrink):g} sensor pixels a pixel"
        panel.set_title(title, fontsize=9)
        panel.set(xlabel="pixels of type", ylim=(-3, 103), xticks=means.index)
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("characters misread, %")
    panels[0].legend(fontsize=7)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Photograph, read, publish."""
    args, sizes, _ = measure.begin(measure.arguments(__doc__ or ""), Sizes(), QUICK_SETTINGS)
    clean, rows = demoire.load("screen").eval(), rows_of_pictures(sizes)
    for preset in sizes.presets:
        for shrink in sizes.shrinks:
            rows += rows_of(preset, shrink, sizes, clean)
            print(preset, shrink, flush=True)
    table, folder = pd.DataFrame(rows), measure.results(args)
    measure.publish(table, folder / "text.csv")
    pictures = measure.ROOT / "docs" if folder == measure.RESULTS else folder
    plot(table, pictures / "text.png")


if __name__ == "__main__":
    main()
