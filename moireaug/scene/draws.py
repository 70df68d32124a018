"""The draw from a scene: one number for each image and ranged field."""

from __future__ import annotations

import functools
import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from numbers import Integral
from typing import Any, NamedTuple, Self

import numpy as np
import torch
from torch import Tensor

from moireaug.common.numeric import is_transformed
from moireaug.scene.by_name import values_of
from moireaug.scene.fields import bounds
from moireaug.scene.record import SceneRecord

MAX_CACHED_SCENES = 64  # of which is kept what is derived from them
ANGLES = ("view.yaw", "view.pitch", "view.roll")
DEVICES_WITHOUT_FLOAT64 = ("mps",)  # by type; the geometry needs it


class Draws(ABC):
    """Numbers drawn for a batch, a row for each image; indexed like the batch."""

    seed: Tensor

    @abstractmethod
    def map_rows(self, f: Callable[[Tensor], Tensor]) -> Self:
        """Return the same draws with `f` of each of their tensors (B,)."""

    def __len__(self) -> int:
        return len(self.seed)

    @property
    def device(self) -> torch.device:
        return self.seed.device

    def to(self, device: torch.device | str) -> Self:
        """Return the same draws on another device.

        Raises:
            TypeError: a device that has no float64, "mps".
        """
        if torch.device(device) == self.device:
            return self
        if torch.device(device).type in DEVICES_WITHOUT_FLOAT64:
            raise TypeError(
                f"photos need a device with float64, for the geometry; got {device}. Move the "
                "images to the CPU, and the photos back."
            )
        return self.map_rows(lambda t: t.to(device))

    def __getitem__(self, rows: Any) -> Self:
        """Return some rows: of a slice, a mask, an index tensor or list, or one integer."""
        if isinstance(rows, str | bool):
            raise TypeError(
                "a shot is indexed like a batch, by whole numbers, a slice or a mask; got "
                f"{rows!r}. Its numbers are fields, such as shot.view.yaw."
            )
        if isinstance(rows, Integral) or (isinstance(rows, Tensor) and rows.dim() == 0):
            rows = [int(rows)]
        return self.map_rows(lambda t: t[rows])

    def repeat(self, n: int) -> Self:
        """Return the whole batch n times, one after another."""
        return self if n == 1 else self.map_rows(lambda t: t.repeat(n))


def random_numbers(n: int, count: int, generator: torch.Generator | None) -> Tensor:
    """Return numbers in [0, 1) to draw from, `count` for each of `n` images: (n, count) float64, on
    the CPU; errors as of `Scene.sample`."""
    if isinstance(n, bool) or not isinstance(n, Integral) or n < 0:
        raise ValueError(f"a shot needs a whole number n >= 0 of images; got n = {n!r}.")
    if not (generator is None or isinstance(generator, torch.Generator)):
        raise TypeError(
            f"generator must be a torch.Generator or None; got {generator!r}. For a seed, pass "
            "torch.Generator().manual_seed(seed)."
        )
    if generator is not None and generator.device.type != "cpu":
        raise ValueError(
            f"shots are drawn on the CPU, whatever device the images are on; got a generator on "
            f"{generator.device}. Pass torch.Generator().manual_seed(seed)."
        )
    return torch.rand(int(n), count, dtype=torch.float64, device="cpu", generator=generator)


class DrawTable(NamedTuple):
    """How the ranged fields of a scene are drawn.

    names: names of the fields, such as "view.yaw", in the order in which they are drawn.
    low: (fields, 1) float64, low ends of all fields.
    ranges: (ranges,) int64, indices of the fields that are not fixed.
    width: (ranges, 1) float64, widths of these.
    """

    names: tuple[str, ...]
    low: np.ndarray
    ranges: np.ndarray
    width: np.ndarray


@functools.lru_cache(maxsize=MAX_CACHED_SCENES)
def draw_table(scene: SceneRecord) -> DrawTable:
    """Return the DrawTable of a scene."""
    fields = values_of(scene)
    low, high = np.array([bounds(value) for value in fields.values()], np.float64).T[..., None]
    # torch.compile knows the length of a list, but not that of np.flatnonzero
    ranges = np.array([i for i, name in enumerate(fields) if scene.is_drawn(name)], np.int64)
    return DrawTable(tuple(fields), low, ranges, (high - low)[ranges])


def numbers_needed(scene: SceneRecord) -> int:
    """Return how many random numbers a shot takes: one for each range, and one for the seed."""
    return len(draw_table(scene).ranges) + 1


def check_random_numbers(u: Tensor, count: int) -> None:
    """Refuse, with a ValueError, anything but `count` numbers in [0, 1) for each image, (n, count);
    values that are hidden in a graph pass."""
    if u.ndim != 2 or u.shape[1] != count:
        raise ValueError(
            f"this draw takes random numbers of the shape (n, {count}), for n images; got "
            f"{tuple(u.shape)}. Get them from random_numbers(n) of what draws."
        )
    if not is_transformed() and not ((u >= 0) & (u < 1)).all():
        raise ValueError(
            f"random numbers to draw from must lie in [0, 1); got {u.min().item():g} to "
            f"{u.max().item():g}. Get them from random_numbers(n) of what draws."
        )


def draw_numbers(scene: SceneRecord, u: Tensor) -> tuple[dict[str, Tensor], Tensor]:
    """Return the ranged fields by name, such as "view.yaw", (n,) float64 each, and seeds, (n,)
    int64, from uniform numbers `u` (n, numbers_needed(scene)) in [0, 1), of which 0 is the low end
    of a range, and the last column gives the seeds; refuse others with a ValueError.

    Only ranges take random numbers: the value of a fixed field does not change the others' draws.
    """
    table = draw_table(scene)
    check_random_numbers(u, len(table.ranges) + 1)
    values = table.low.repeat(len(u), 1)
    values[table.ranges] += table.width * u[:, :-1].mT.numpy()
    numbers = {}
    for name, row in zip(table.names, values, strict=True):
        numbers[name] = torch.from_numpy(row.copy())  # else pickled with the whole table
    if scene.view.pose == "released":
        for angle in ANGLES:
            numbers[angle] = numbers[angle].floor()  # the released code turns by whole degrees
    return numbers, (u[:, -1] * 2**53).to(torch.int64)


def check_drawn(numbers: Mapping[str, Any], seed: Any) -> None:
    """Refuse fields and seeds that are not tensors of one number per image: ValueError."""
    if not isinstance(seed, Tensor) or seed.dtype != torch.int64 or seed.ndim != 1:
        got = f"{tuple(seed.shape)} {seed.dtype}" if isinstance(seed, Tensor) else repr(seed)
        raise ValueError(f"a shot's seed must be (B,) int64; got {got}.")
    for name, values in numbers.items():
        if not isinstance(values, Tensor) or values.shape != seed.shape:
            got = str(tuple(values.shape)) if isinstance(values, Tensor) else repr(values)
            raise ValueError(
                "a shot's fields must be tensors of one number per image, here of shape "
                f"({len(seed)},); got {got} as shot.{name}."
            )


def check_size(size: Any) -> tuple[int, int]:
    """Return a size (height, width) in integers; refuse anything but two whole numbers of at least
    1 with a ValueError."""
    try:
        h, w = (operator.index(side) for side in size)
    except (TypeError, ValueError):  # no pair, or no integers
        h, w = 0, 0
    if h < 1 or w < 1:
        raise ValueError(
            "a shot needs a size (height, width) of at least 1 x 1 pixels, in whole numbers; got "
            f"{size!r}."
        )
    return h, w


def mix_seeds(*parts: int) -> int:
    """Return one seed from several integers, the same on every machine."""
    seed = 0
    for part in parts:
        seed = (seed * 1_000_003 + part + 12_289) % (2**63 - 1)
    return seed
