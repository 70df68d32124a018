"""Pictures to photograph: drawn ones, or a folder's; some are held out for testing."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from moireaug.synthesis.pictures import Pictures, Source
from training.data import drawn_pictures
from training.data.splits import shuffled_indices
from training.demoireing.schema import DemoireConfig
from training.runs.identity import fingerprint_of
from training.system.files import has_parts
from training.system.messages import count_text

SPLIT_DIVISOR = 10  # a tenth of the pictures validates, and a tenth tests


class Splits(NamedTuple):
    """The pictures of the pairs that train, validate and test; none is in two of them."""

    train: Source
    val: Source
    test: Source

    @property
    def files(self) -> str:
        """Fingerprint of the names of each split's pictures; empty where they are drawn."""
        names = {}
        for split, source in self._asdict().items():
            if isinstance(source, Pictures):
                names[split] = source.names
        return fingerprint_of(names) if names else ""

    @property
    def classes(self) -> dict[int, str]:
        """No classes: a network that cleans has no logits."""
        return {}


class DrawnPictures:
    """The project's own pictures, a new one for every pair."""

    def __init__(self, side: int) -> None:
        self.side = side

    def draw(self, rng: np.random.Generator) -> tuple[str, Image.Image]:
        """Draw a picture; return its kind and the picture."""
        return drawn_pictures.render(rng, self.side)


class EnlargedCrops:
    """Crops of another source's pictures, enlarged."""

    def __init__(self, source: Source, side: int, factor: int) -> None:
        self.source, self.side, self.factor = source, side, factor

    def draw(self, rng: np.random.Generator) -> tuple[str, Image.Image]:
        """Draw a picture and a crop of it; return the picture's name and the enlarged crop."""
        name, picture = self.source.draw(rng)
        left = int(rng.integers(picture.width - self.side + 1))
        top = int(rng.integers(picture.height - self.side + 1))
        crop = picture.crop((left, top, left + self.side, top + self.side))
        length = self.factor * self.side
        return name, crop.resize((length, length), Image.Resampling.BICUBIC)


def load(cfg: DemoireConfig) -> Splits:
    """Find the pictures of a run's data set."""
    side, test_side = cfg.data.size, cfg.test.size
    if not cfg.data.root:
        drawn = DrawnPictures(side)
        return Splits(drawn, drawn, DrawnPictures(test_side))
    root = Path(cfg.data.root)
    if has_parts(root):
        train, val = split_tenths(Pictures(root / "train", side), 2)
        return Splits(train, val, Pictures(root / "test", test_side))
    train, val, test = split_tenths(Pictures(root, side), 3)
    test.min_side = test_side
    return Splits(train, val, test)


def require_usable(splits: Splits) -> None:
    """Read a picture of each split, before any time is spent."""
    for name, setting in (("train", "data.size"), ("val", "data.size"), ("test", "test.size")):
        try:
            getattr(splits, name).draw(np.random.default_rng(0))
        except ValueError as error:
            raise ValueError(
                f"no pictures to {name} on: {error} Pass a smaller {setting}=N, or a folder of "
                "other pictures."
            ) from error


def split_tenths(pictures: Pictures, parts: int) -> list[Pictures]:
    """Split pictures at random, always the same way: most of them, and as many tenths as there are
    other parts."""
    total = len(pictures)
    if total < parts:
        uses = "train and validate" if parts == 2 else "train, validate and test"
        raise ValueError(
            f"{pictures.folder} holds {count_text(total, 'picture')}: at least {parts} are needed, "
            f"to {uses} on different ones."
        )
    count = max(1, total // SPLIT_DIVISOR)
    order = shuffled_indices(total, 0)
    small_parts = [pictures.subset(order[n * count : (n + 1) * count]) for n in range(parts - 1)]
    return [pictures.subset(order[(parts - 1) * count :]), *small_parts]
