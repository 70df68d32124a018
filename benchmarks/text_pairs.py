"""Real photos of screens against simulated ones: is as much of their text read?

    python benchmarks/text_pairs.py DIR        # writes results/text_pairs.csv
    python benchmarks/text_pairs.py DIR --quick

In DIR lie screenshot1.png and photo1.jpg, ... A photo is brought to its screenshot's frame by
matched points. What is read of it, and of simulated photos of the same part of the screen with as
many sensor pixels a panel pixel, shrunk with and without averaging, is compared with what is read
of the screenshot's part, at the photo's size and without spaces: character error rates as in
text.py, which says what to install.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pandas as pd
import torch
from PIL import Image
from torch import Tensor

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

from benchmarks import measure
from benchmarks.text import errors, read
from moireaug import Scene, capture
from moireaug.scene.by_name import with_values
from moireaug.synthesis import without_moire
from moireaug.synthesis.twins import moire_codes

MIN_MATCHES = 12  # points that a homography rests on
MIN_CHARACTERS = 20  # of a part that is counted
SENSOR_PIXELS = 4032.0  # along a photo's longer side, before it was shrunk


@dataclass(frozen=True)
class Sizes:
    """What is photographed, how often."""

    shots: int = 2
    pairs: int | None = None


QUICK_SETTINGS = Sizes(1, 2)


class Part(NamedTuple):
    """A part of a screenshot that a photo shows.

    Args:
        picture, photo: (H, W, 3) uint8, the part and the photo of it, at the photo's resolution.
        panel_pixels: panel pixels across the longer side.
        shrink: sensor pixels a pixel.
    """

    picture: np.ndarray
    photo: np.ndarray
    panel_pixels: float
    shrink: float


def part_of(photo: np.ndarray, screenshot: np.ndarray) -> Part | None:
    """Return the part of a screenshot that a photo shows, (H, W, 3) uint8 each; None if too few
    points match."""
    to_photo = homography(screenshot, photo)
    if to_photo is None:
        return None
    height, width = photo.shape[:2]
    corners = np.array([[[0, 0], [width, 0], [width, height], [0, height]]], np.float32)
    seen = cv2.perspectiveTransform(corners, np.linalg.inv(to_photo))[0]
    along = np.sort(seen, 0)  # the middle two of four corners: what lies between is in the photo
    low = np.maximum(along[1], 0)
    high = np.minimum(along[2], screenshot.shape[1::-1])
    scale = np.sqrt(width * height / cv2.contourArea(seen))
    size = [round(side) for side in ((high - low) * scale).tolist()]
    if min(size) < 100:
        return None
    to_part = np.diag([scale, scale, 1.0]) @ np.array([[1, 0, -low[0]], [0, 1, -low[1]], [0, 0, 1]])
    picture = cv2.warpPerspective(screenshot, to_part, size, flags=cv2.INTER_LINEAR)
    if scale < 1:
        cut = screenshot[int(low[1]) : int(high[1]), int(low[0]) : int(high[0])]
        picture = cv2.resize(cut, size, interpolation=cv2.INTER_AREA)
    to_part = to_part @ np.linalg.inv(to_photo)
    found = cv2.warpPerspective(photo, to_part, size, flags=cv2.INTER_CUBIC)
    return Part(picture, found, float((high - low).max()), SENSOR_PIXELS / max(height, width))


def homography(one: np.ndarray, other: np.ndarray) -> np.ndarray | None:
    """Return the homography (3, 3) from one picture (H, W, 3) to another, by SIFT and RANSAC."""
    finder = cv2.SIFT_create(10000, contrastThreshold=0.02)
    (a, features), (b, others) = (
        finder.detectAndCompute(picture, None) for picture in (one, other)
    )
    pairs = cv2.BFMatcher().knnMatch(others, features, k=2)
    good = [first for first, second in pairs if first.distance < 0.8 * second.distance]
    if len(good) < MIN_MATCHES:
        return None
    source = np.array([a[match.trainIdx].pt for match in good], np.float32)
    target = np.array([b[match.queryIdx].pt for match in good], np.float32)
    found, is_kept = cv2.findHomography(source, target, cv2.RANSAC, 4.0)
    return found if found is not None and is_kept.sum() >= MIN_MATCHES else None


@torch.no_grad()
def rows_of(pair: str, part: Part, sizes: Sizes) -> list[dict]:
    """Return the error rates of a part's photo and of simulated ones."""
    text = read(part.picture)
    if len(text) < MIN_CHARACTERS:
        return []
    facts = {"pair": pair, "characters": len(text), "panel pixels": part.panel_pixels}
    (real,) = errors(tensor(part.photo), [text])
    rows = [facts | {"photo": "real", "error": real, "n": 1}]
    picture = tensor(part.picture)
    images = picture.expand(sizes.shots, -1, -1, -1)
    for name, scene in scenes_of(part).items():
        size = (picture.shape[-2], picture.shape[-1])
        shot = scene.sample(sizes.shots, size, torch.Generator().manual_seed(0))
        photos, twins = capture(images, shot), capture(images, without_moire(shot))
        moire = float(moire_codes(photos, twins).median())
        for state, shown in (("", photos), (", without moiré", twins)):
            error = float(np.mean(errors(shown, [text] * sizes.shots)))
            row = {"photo": name + state, "error": error, "n": sizes.shots, "moire": moire}
            rows.append(facts | row)
    return rows


def scenes_of(part: Part) -> dict[str, Scene]:
    """Return scenes of a part of the screen with as many sensor pixels as its photo, by how these
    become its pixels."""
    preset, longer = Scene.preset("screen_photo"), max(part.picture.shape)
    scale = part.panel_pixels / longer  # panel pixels a pixel
    averaged = with_values(preset.with_shrink(part.shrink), {"sensor.pitch": part.shrink / scale})
    full = {"panel.width": 0.0, "sensor.pitch": 0.0}
    full |= {"panel.scale": scale, "sensor.scale": part.shrink}
    return {
        "shrunk by averaging": averaged,
        "shrunk without": with_values(preset, full | {"develop.resize": "point"}),
    }


def tensor(picture: np.ndarray) -> Tensor:
    """Return a picture (H, W, 3) uint8 as (1, 3, H, W) in [0, 1]."""
    return torch.from_numpy(picture).permute(2, 0, 1)[None].float() / 255


def main() -> None:
    """Match, photograph, read, publish."""
    parser = measure.arguments(__doc__ or "")
    parser.add_argument("pairs", type=Path, help="folder of screenshots and photos")
    args, sizes, _ = measure.begin(parser, Sizes(), QUICK_SETTINGS)
    rows: list[dict] = []
    for path in sorted(args.pairs.glob("screenshot*.png"))[: sizes.pairs]:
        photo_path = path.with_name(path.name.replace("screenshot", "photo")).with_suffix(".jpg")
        pictures = (np.array(Image.open(one).convert("RGB")) for one in (photo_path, path))
        part = part_of(*pictures)
        print(f"{path.name}: {'too few points match' if part is None else part.picture.shape}")
        rows += [] if part is None else rows_of(path.stem, part, sizes)
    table = pd.DataFrame(rows)
    measure.publish(table, measure.results(args) / "text_pairs.csv")
    weighted = table.assign(wrong=table["error"] * table["characters"])
    sums = weighted.groupby("photo", sort=False)[["wrong", "characters"]].sum()
    print(measure.text_of((sums["wrong"] / sums["characters"]).rename("error").reset_index()))


if __name__ == "__main__":
    main()
