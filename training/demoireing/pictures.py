"""Pictures to photograph: signs that are drawn, or a folder's; some are held out for testing."""

from __future__ import annotations

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from moireaug.files import write_text
from moireaug.synthesis.pictures import Pictures, Source
from training.data import signs
from training.data.splits import has_parts, shuffled_indices
from training.demoireing.schema import DemoireConfig
from training.system.files import read_json
from training.system.messages import counted

NAMES = "pictures.json"  # of a run: the names of each split's pictures
HELD_OUT = 10  # one picture in ten validates, and one in ten tests


class Splits(NamedTuple):
    """Where the pairs that train, validate and test take their pictures; none is in two of them."""

    train: Source
    val: Source
    test: Source


class DrawnSigns:
    """The project's own signs, a new one for every pair.

    Args:
        side: of a picture, in pixels.
    """

    def __init__(self, side: int) -> None:
        self.side = side

    def draw(self, rng: np.random.Generator) -> tuple[str, Image.Image]:
        """Draw a sign; return its class and its picture."""
        label = int(rng.integers(len(signs.CLASSES)))
        return signs.CLASSES[label], Image.fromarray(signs.render(label, rng, self.side))


def load(cfg: DemoireConfig) -> Splits:
    """Find the pictures of a run's data set.

    Raises:
        ValueError: no folder, or too few pictures in it.
    """
    side, test_side = cfg.data.size, cfg.test.size
    if not cfg.data.root:
        drawn = DrawnSigns(side)
        return Splits(drawn, drawn, DrawnSigns(test_side))
    root = Path(cfg.data.root)
    if has_parts(root):
        train, val = _parts(Pictures(root / "train", side), 2)
        return Splits(train, val, Pictures(root / "test", test_side))
    train, val, test = _parts(Pictures(root, side), 3)
    test.min_side = test_side
    return Splits(train, val, test)


def require_usable(splits: Splits) -> None:
    """Read a picture of each split, before any time is spent.

    Raises:
        ValueError: none of a split is large enough, or none can be read.
    """
    for name, setting in (("train", "data.size"), ("val", "data.size"), ("test", "test.size")):
        try:
            getattr(splits, name).draw(np.random.default_rng(0))
        except ValueError as error:
            raise ValueError(
                f"no pictures to {name} on: {error} Pass a smaller {setting}=N, or a folder of "
                "other pictures."
            ) from error


def keep(folder: Path, splits: Splits) -> None:
    """Write the names of each split's pictures into a run's folder."""
    if names := _names(splits):
        write_text(folder / NAMES, json.dumps(names, indent=1))


def require_same(folder: Path, splits: Splits) -> None:
    """Refuse to go on with a run whose pictures have changed: those that it was trained on could
    test it.

    Raises:
        ValueError: with what to do instead.
    """
    there = read_json(folder / NAMES)
    if there is not None and there != _names(splits):
        raise ValueError(
            f"data.root holds other pictures than when {folder} was trained, so pictures that it "
            "was trained on could test it. Restore them, or pass resume=false to train again."
        )


def _names(splits: Splits) -> dict[str, list[str]]:
    """Return the names of each split's pictures; empty where they are drawn."""
    found = {}
    for split, source in splits._asdict().items():
        if isinstance(source, Pictures):
            found[split] = source.names
    return found


def _parts(pictures: Pictures, parts: int) -> list[Pictures]:
    """Split pictures at random, always the same way: most of them, and as many tenths as there are
    other parts."""
    total = len(pictures)
    if total < parts:
        uses = "train and validate" if parts == 2 else "train, validate and test"
        raise ValueError(
            f"{pictures.folder} holds {counted(total, 'picture')}: at least {parts} are needed, to "
            f"{uses} on different ones."
        )
    held = max(1, total // HELD_OUT)
    order = shuffled_indices(total, 0)
    others = [pictures.subset(order[n * held : (n + 1) * held]) for n in range(parts - 1)]
    return [pictures.subset(order[(parts - 1) * held :]), *others]
