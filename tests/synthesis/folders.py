"""Folders of pictures that the tests of pairs share."""

import numpy as np
from PIL import Image


def put(folder, sizes=((60, 40), (44, 50), (40, 90))):
    """Write smooth colour pictures of these sizes (width, height), deep inside a folder."""
    rng = np.random.default_rng(5)
    for number, size in enumerate(sizes):
        path = folder / f"class{number % 2}" / f"{number}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        coarse = Image.fromarray(rng.integers(0, 256, (12, 12, 3), dtype=np.uint8))
        coarse.resize(size, Image.Resampling.BICUBIC).save(path)
    return folder


def spoil(folder):
    """Add files that are no usable pictures: truncated, too small, no image, not named as one."""
    whole = (folder / "class0/0.png").read_bytes()
    (folder / "torn.png").write_bytes(whole[: len(whole) // 2])
    (folder / "words.jpg").write_text("no picture")
    Image.new("RGB", (200, 20)).save(folder / "low.png")
    (folder / "notes.txt").write_text("labels")
    (folder / ".hidden.png").write_text("")
    return folder
