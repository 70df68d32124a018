"""Unit cells of subpixels, as data: parallelograms that emit one colour each."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterable
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any

from moireaug.common.argument_checks import one_of
from moireaug.scene.subpixel import Subpixel, in_smallest_cell, is_overlapping

RED, GREEN, BLUE = 0, 1, 2
MAX_RASTER = 24  # raster subpixels along a panel pixel, where no smaller number fits


@dataclass(frozen=True)
class Layout:
    """A unit cell of subpixels, repeated over the panel.

        Panel(layout=Layout(((0, 0, 0, 0.5, 1), (1, 0.5, 0, 1, 0.5), (2, 0.5, 0.5, 1, 1))))

    Args:
        subpixels: each `(channel, x0, y0, x1, y1)`, a rectangle, or
            `(channel, cx, cy, ax, ay, dx, dy)`, a parallelogram by its centre and two edge vectors,
            which may reach into the next cell. Channel 0 is red, 1 green, 2 blue; lengths in panel
            pixels from the cell's upper left corner, x right, y down. Subpixels of one channel must
            not overlap.
        period: width and height of the cell, in whole panel pixels.

    Raises:
        ValueError, TypeError: a subpixel that is empty, leaves the cell or overlaps another of its
            channel, an unknown channel, no subpixel at all, or a period that is not two whole
            numbers in [1, 16].
    """

    subpixels: tuple[tuple[float, ...], ...]
    period: tuple[int, int] = (1, 1)

    def __post_init__(self) -> None:
        for name in ("subpixels", "period"):
            if not isinstance(getattr(self, name), (tuple, list)):
                raise TypeError(f"Layout.{name} must be a tuple; got {getattr(self, name)!r}.")
        period = tuple(self.period)
        if len(period) != 2 or any(not _is_whole(p) for p in period):
            raise ValueError(
                f"Layout.period must be two whole numbers of panel pixels in [1, 16]; got {period}."
            )
        period = (int(period[0]), int(period[1]))
        object.__setattr__(self, "period", period)
        if not self.subpixels:
            raise ValueError(
                "Layout.subpixels must hold at least one (channel, x0, y0, x1, y1) rectangle; got "
                "none."
            )
        checked = tuple(_checked(numbers, period) for numbers in self.subpixels)
        object.__setattr__(self, "subpixels", checked)
        for first, second in itertools.combinations(checked, 2):
            one, other = _subpixel(first, period), _subpixel(second, period)
            if one.channel == other.channel and is_overlapping(other, one):
                raise ValueError(
                    f"subpixels of one channel must not overlap; got {first!r} and {second!r}."
                )

    def of(self, channel: int) -> tuple[Subpixel, ...]:
        """Return the subpixels of one channel, in the smallest cell that its colour repeats with,
        which may be a part of the layout's."""
        return _of(self, channel)

    def all(self) -> tuple[Subpixel, ...]:
        """Return the subpixels of every channel, each in its colour's smallest cell."""
        return (*self.of(RED), *self.of(GREEN), *self.of(BLUE))

    @property
    def is_solid(self) -> bool:
        """Whether every panel pixel emits all colours over its whole area."""
        whole = {(c, 0, 0, 1, 1) for c in (RED, GREEN, BLUE)}
        return self.period == (1, 1) and set(self.subpixels) == whole

    @property
    def raster(self) -> int:
        """Raster subpixels along each side of a panel pixel: the smallest number on which all
        corners fall, at most 24."""
        edges = [v for s in self.all() for corner in s.corners() for v in corner]
        for n in range(1, MAX_RASTER + 1):
            if all(abs(e * n - round(e * n)) < 1e-6 for e in edges):
                return n
        return MAX_RASTER


@functools.lru_cache(maxsize=256)
def _of(layout: Layout, channel: int) -> tuple[Subpixel, ...]:
    found = [_subpixel(row, layout.period) for row in layout.subpixels if row[0] == channel]
    return tuple(in_smallest_cell(found))


def _is_whole(period: Any) -> bool:
    return isinstance(period, Integral) and not isinstance(period, bool) and 1 <= int(period) <= 16


def _checked(numbers: Any, period: tuple[int, int]) -> tuple[float, ...]:
    """Return one subpixel's numbers as a tuple, or raise if they are invalid."""
    numbers = tuple(numbers) if isinstance(numbers, Iterable) else (numbers,)
    strange = [v for v in numbers if isinstance(v, bool) or not isinstance(v, Real)]
    if len(numbers) not in (5, 7) or strange:
        raise TypeError(
            "Layout.subpixels must be (channel, x0, y0, x1, y1) rectangles or (channel, cx, cy, "
            f"ax, ay, dx, dy) parallelograms, all numbers; got {numbers!r}."
        )
    if numbers[0] not in (RED, GREEN, BLUE):
        raise ValueError(
            f"a subpixel's channel must be 0 (red), 1 (green) or 2 (blue); got {numbers[0]!r} in "
            f"{numbers!r}."
        )
    # as they are in a file: not NumPy's, or fractions
    numbers = (int(numbers[0]), *(v if isinstance(v, int) else float(v) for v in numbers[1:]))
    if len(numbers) == 5:
        _, x0, y0, x1, y1 = numbers
        if not (0 <= x0 < x1 <= period[0] and 0 <= y0 < y1 <= period[1]):
            raise ValueError(
                f"a subpixel must have x0 < x1 and y0 < y1 inside its cell of {period[0]} x "
                f"{period[1]} panel pixels; got {numbers!r}."
            )
        return numbers
    subpixel = _subpixel(numbers, period)
    box = subpixel.box()
    for axis, name in enumerate(("wide", "high")):
        extent = box[axis + 2] - box[axis]
        if not (0 <= numbers[1 + axis] <= period[axis] and extent <= period[axis] + 1e-9):
            raise ValueError(
                "a parallelogram must have its centre in its cell and be no larger than it; got "
                f"{numbers!r}, {extent:g} panel pixels {name} in a cell of {period[0]} x "
                f"{period[1]}."
            )
    if subpixel.area == 0:
        raise ValueError(
            f"a parallelogram must have an area: its edges must not be parallel; got {numbers!r}."
        )
    return numbers


def _subpixel(numbers: tuple[float, ...], period: tuple[int, int]) -> Subpixel:
    if len(numbers) == 7:
        channel, cx, cy, ax, ay, dx, dy = numbers
        # on the far edge of its cell lies the copy of one on the near edge
        centre = (cx % period[0], cy % period[1])
        return Subpixel(int(channel), centre, (ax, ay), (dx, dy), period)
    channel, x0, y0, x1, y1 = numbers
    # rounded, so that three thirds have one width
    width, height = round(x1 - x0, 12), round(y1 - y0, 12)
    centre = ((x0 + x1) / 2, (y0 + y1) / 2)
    return Subpixel(int(channel), centre, (width, 0.0), (0.0, height), period)


def layout_from_dict(values: dict[str, Any]) -> Layout:
    """Return a Layout from a dict of its two fields."""
    for key in values:
        one_of("a field of Panel.layout", key, ("subpixels", "period"))
    if "subpixels" not in values:
        raise ValueError(
            "Panel.layout must name its subpixels, (channel, x0, y0, x1, y1) rectangles or "
            f"parallelograms; got {values!r}. See moireaug.scene.layout.Layout."
        )
    return Layout(**values)


def stripes(*channels: int) -> Layout:
    """Return full-height vertical stripes, left to right."""
    n = len(channels)
    return Layout(tuple((c, i / n, 0.0, (i + 1) / n, 1.0) for i, c in enumerate(channels)))


def chevrons(slant: float) -> Layout:
    """Return vertical stripes that lean by `slant` panel pixels a row, to the right in one row and
    to the left in the next."""
    subpixels = []
    for row, lean in enumerate((slant, -slant)):
        for channel in (RED, GREEN, BLUE):
            centre = ((channel + 0.5) / 3, row + 0.5)
            subpixels.append((channel, *centre, 1 / 3, 0.0, lean, 1.0))
    return Layout(tuple(subpixels), (1, 2))


def diamonds(green: float, other: float) -> Layout:
    """Return diamond PenTile: a green diamond in each pixel, and red and blue ones alternating at
    the corners where four pixels meet. `green` and `other` are half diagonals in panel pixels."""
    subpixels = []
    for row, column in itertools.product((0, 1), repeat=2):
        subpixels.append((GREEN, column + 0.5, row + 0.5, green, green, -green, green))
        channel = RED if row == column else BLUE
        subpixels.append((channel, float(column), float(row), other, other, -other, other))
    return Layout(tuple(subpixels), (2, 2))


LAYOUTS: dict[str, Layout] = {
    "rgb_stripe": stripes(RED, GREEN, BLUE),
    "bgr_stripe": stripes(BLUE, GREEN, RED),
    # a stripe panel turned on its side: each pixel is a column of three bars
    "rgb_column": Layout(tuple((c, 0.0, c / 3, 1.0, (c + 1) / 3) for c in (RED, GREEN, BLUE))),
    # PenTile RGBG: two pixels share a red and a blue subpixel, twice as wide as their own greens
    "pentile": Layout(
        ((0, 0, 0, 2 / 3, 1), (1, 2 / 3, 0, 1, 1), (2, 1, 0, 5 / 3, 1), (1, 5 / 3, 0, 2, 1)), (2, 1)
    ),
    # stripes of dual-domain LCDs (IPS, VA): rows lean right and left in turn, here by 11 degrees
    "chevron": chevrons(0.2),
    # OLED phones: as many greens as pixels, half as many reds and blues, twice as large here
    "pentile_diamond": diamonds(0.45 / 2**0.5, 0.45),
    # OLED televisions: a white stripe beside red, blue and green ones
    "wrgb": Layout(
        (
            (RED, 0.0, 0.0, 0.25, 1.0),
            *((c, 0.25, 0.0, 0.5, 1.0) for c in (RED, GREEN, BLUE)),
            (BLUE, 0.5, 0.0, 0.75, 1.0),
            (GREEN, 0.75, 0.0, 1.0, 1.0),
        )
    ),
    # OLED monitors and televisions with quantum dots: green above red and blue, of equal area
    "oled_triangle": Layout(
        ((GREEN, 0.2, 0.04, 0.8, 0.44), (RED, 0.0, 0.5, 0.5, 0.98), (BLUE, 0.5, 0.5, 1.0, 0.98))
    ),
    # one package with three dies stacked vertically, as in surface-mounted LEDs
    "led": Layout(
        tuple((c, 0.25, 0.25 + c / 6, 0.75, 0.25 + (c + 1) / 6) for c in (RED, GREEN, BLUE))
    ),
    # chips on board: three bare dies in a row, dark all around
    "led_cob": Layout(
        tuple((c, 0.26 + 0.18 * c, 0.4, 0.38 + 0.18 * c, 0.6) for c in (RED, GREEN, BLUE))
    ),
    # as a print or a projection: no moiré unless lit < 1
    "even": Layout(tuple((c, 0.0, 0.0, 1.0, 1.0) for c in (RED, GREEN, BLUE))),
}
