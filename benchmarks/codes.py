"""Are codes on screens read from their photos? QR, Data Matrix and EAN-13 of several module sizes,
whole and as crops, in every preset of "anywhere".

    pip install zxing-cpp
    python benchmarks/codes.py             # minutes; writes results/codes.csv and docs/codes.png
    python benchmarks/codes.py --photos DIR      # real photos of QR codes; writes codes_real.csv
    python benchmarks/codes.py --quick

Each code is drawn and read by zxing-cpp, and read by OpenCV, too, where it can. A photo is compared
with its twin, the same shot without moiré: what the twin loses, too, is lost to blur, noise, light
and bands of flicker. Real photos, which DIR holds, are read as they are and shrunk by area to the
sizes of a module; one that zxing-cpp cannot read has no known size, and counts as not read.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import torch
import zxingcpp
from matplotlib.figure import Figure
from PIL import Image
from torch import Tensor

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

from benchmarks import measure
from moireaug import Scene, capture
from moireaug.mixtures import as_scenes, scenes_of
from moireaug.scene.presets import MIXTURES
from moireaug.synthesis import without_moire
from moireaug.synthesis.twins import moire_codes

TEXTS = {"QR": "https://example.org/a1b2c3", "Data Matrix": "A1B2C3D4E5", "EAN-13": "4006381333931"}
FORMATS = {
    "QR": zxingcpp.BarcodeFormat.QRCode,
    "Data Matrix": zxingcpp.BarcodeFormat.DataMatrix,
    "EAN-13": zxingcpp.BarcodeFormat.EAN13,
}
WHOLE_PHOTO = "whole"  # in place of a shrink
PLOTTED_READER = "zxing-cpp"


@dataclass(frozen=True)
class Sizes:
    """What is photographed and how often."""

    side: int = 256  # pixels of a picture
    modules: tuple[int, ...] = (1, 2, 3, 4, 6, 8)  # pixels of one module
    shrinks: tuple[float | str, ...] = (1.0, 2.0, 4.0, WHOLE_PHOTO)
    presets: tuple[str, ...] = MIXTURES["anywhere"]
    shots: int = 16


QUICK_SETTINGS = Sizes(128, (4,), (1.0, WHOLE_PHOTO), ("screen_photo",), 2)


def drawn(code: str, module: int, side: int) -> Tensor | None:
    """Return a code with its quiet zone in the middle of a white picture (3, side, side), with
    `module` pixels a module; None where it does not fit."""
    barcode = zxingcpp.create_barcode(TEXTS[code], FORMATS[code])
    pixels = np.array(barcode.to_image(scale=module, add_quiet_zones=True))
    height, width = pixels.shape
    if max(height, width) > side:
        return None
    picture = torch.full((side, side), 255, dtype=torch.uint8)
    top, left = (side - height) // 2, (side - width) // 2
    picture[top : top + height, left : left + width] = torch.from_numpy(pixels)
    return (picture.float() / 255).expand(3, -1, -1)


def read_by_zxing(code: str, photo: np.ndarray) -> bool:
    """Return whether zxing-cpp reads a code's own text from a photo (H, W, 3) uint8."""
    found = zxingcpp.read_barcodes(photo, formats=FORMATS[code])
    return any(one.text == TEXTS[code] for one in found)


def read_by_opencv(code: str, photo: np.ndarray) -> bool:
    """Return whether OpenCV reads a code's own text from a photo (H, W, 3) uint8."""
    grey = cv2.cvtColor(photo, cv2.COLOR_RGB2GRAY)
    detector = cv2.QRCodeDetector() if code == "QR" else cv2.barcode.BarcodeDetector()
    try:
        return detector.detectAndDecode(grey)[0] == TEXTS[code]
    except cv2.error:  # corners of no area, which it has found itself
        return False


READERS = {"zxing-cpp": read_by_zxing, "OpenCV": read_by_opencv}
UNREAD_BY_OPENCV = "Data Matrix"


def rows_of(preset: str, shrink: float | str, sizes: Sizes) -> list[dict]:
    """Return the shares of photos and twins that are read, of every code and module size."""
    (scene,) = scenes_of(as_scenes(preset, None if shrink == WHOLE_PHOTO else shrink))
    rows = []
    for code in TEXTS:
        for module in sizes.modules:
            picture = drawn(code, module, sizes.side)
            if picture is not None:
                facts = {"preset": preset, "shrink": shrink, "code": code, "module": module}
                rows.append(facts | shares_read(code, picture, scene, sizes.shots))
    return rows


@torch.no_grad()
def shares_read(code: str, picture: Tensor, scene: Scene, n: int) -> dict[str, float]:
    """Return the shares of n photos of a picture (3, H, W), and of their twins, that each reader
    reads, and the photos' moiré in codes."""
    images = picture.expand(n, -1, -1, -1)
    generator = torch.Generator().manual_seed(0)
    shot = scene.sample(n, (images.shape[-2], images.shape[-1]), generator)
    shown = {"photo": capture(images, shot), "twin": capture(images, without_moire(shot))}
    found: dict[str, float] = {"n": n, "moire": float(moire_codes(*shown.values()).median())}
    for kind, photos in shown.items():
        arrays = (255 * photos).round().byte().permute(0, 2, 3, 1).contiguous().numpy()
        for reader, reads in READERS.items():
            if reader == "OpenCV" and code == UNREAD_BY_OPENCV:
                continue
            found[f"{kind}, {reader}"] = float(np.mean([reads(code, photo) for photo in arrays]))
    return found


def rows_of_real(folder: Path, sizes: Sizes) -> list[dict]:
    """Return the shares of a folder's photos of QR codes that each reader reads, as they are
    (module 0) and shrunk to each size of a module."""
    read = []
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in (".jpg", ".png"))
    for path in paths:
        photo = np.array(Image.open(path).convert("RGB"))
        found = zxingcpp.read_barcodes(photo, formats=FORMATS["QR"])
        module = module_of(found[0]) if found else 0.0
        for size in (0, *sizes.modules):
            shown = photo
            if size and module:
                factor = size / module
                shown = cv2.resize(photo, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
            row = {"module": size, "photo": path.name, "pixels a module": module}
            if module or not size:
                row |= {reader: any_text(shown) != "" for reader, any_text in ANY_TEXT.items()}
            else:
                row |= dict.fromkeys(ANY_TEXT, False)
            read.append(row)
    shares = pd.DataFrame(read).groupby("module").agg(
        n=("photo", "size"), median_pixels=("pixels a module", "median"),
        **{reader: (reader, "mean") for reader in ANY_TEXT},
    )  # fmt: skip
    return shares.reset_index().to_dict("records")


def module_of(code: zxingcpp.Barcode) -> float:
    """Return the mean pixels of a QR code's module, by its corners and version."""
    corners = [getattr(code.position, name) for name in CORNERS]
    points = np.array([(corner.x, corner.y) for corner in corners], float)
    sides = np.linalg.norm(points - np.roll(points, 1, 0), axis=1)
    return float(sides.mean() / (17 + 4 * int(code.extra["Version"])))


def any_text_by_zxing(photo: np.ndarray) -> str:
    found = zxingcpp.read_barcodes(photo, formats=FORMATS["QR"])
    return found[0].text if found else ""


def any_text_by_opencv(photo: np.ndarray) -> str:
    try:
        return cv2.QRCodeDetector().detectAndDecode(cv2.cvtColor(photo, cv2.COLOR_RGB2GRAY))[0]
    except cv2.error:  # as in read_by_opencv
        return ""


ANY_TEXT = {"zxing-cpp": any_text_by_zxing, "OpenCV": any_text_by_opencv}
CORNERS = ("top_left", "top_right", "bottom_right", "bottom_left")


def plot(table: pd.DataFrame, path: Path) -> None:
    """Draw the share that is read against the module's size, over all presets."""
    figure = Figure(figsize=(9, 3), layout="constrained")
    panels = figure.subplots(1, len(TEXTS), sharey=True)
    for panel, code in zip(panels, TEXTS, strict=True):
        for shrink, colour in zip(table["shrink"].unique(), ("C0", "C1", "C2", "C3"), strict=False):
            chosen = table[(table["code"] == code) & (table["shrink"] == shrink)]
            means = chosen.groupby("module")[
                [f"photo, {PLOTTED_READER}", f"twin, {PLOTTED_READER}"]
            ].mean()
            label = (
                "whole photo" if shrink == WHOLE_PHOTO else f"{float(shrink):g} x {float(shrink):g}"
            )
            panel.plot(means.index, 100 * means.iloc[:, 0], "o-", color=colour, label=label)
            panel.plot(means.index, 100 * means.iloc[:, 1], "--", color=colour, alpha=0.6)
        modules = sorted(table.loc[table["code"] == code, "module"].unique())
        panel.set(title=code, xlabel="pixels a module", ylim=(-4, 104), xticks=modules)
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("photos that are read, %")
    title = "sensor pixels a pixel\n(dashed: without moiré)"
    panels[0].legend(fontsize=7, title=title, title_fontsize=7)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Photograph, read, publish."""
    parser = measure.arguments(__doc__ or "")
    parser.add_argument("--photos", type=Path, help="folder of real photos, to read them alone")
    args, sizes, _ = measure.begin(parser, Sizes(), QUICK_SETTINGS)
    if args.photos:
        real = pd.DataFrame(rows_of_real(args.photos, sizes))
        measure.publish(real, measure.results(args) / "codes_real.csv")
        return
    rows = []
    for preset in sizes.presets:
        for shrink in sizes.shrinks:
            rows += rows_of(preset, shrink, sizes)
    table = pd.DataFrame(rows)
    folder = measure.results(args)
    measure.publish(table, folder / "codes.csv")
    pictures = measure.ROOT / "docs" if folder == measure.RESULTS else folder
    plot(table, pictures / "codes.png")


if __name__ == "__main__":
    main()
