"""Subpixels: parallelograms that emit one colour each, repeated over the panel."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

Vector = tuple[float, float]
MATCHING_DIGITS = 9  # to which two subpixels must agree to be copies of each other


@dataclass(frozen=True)
class Subpixel:
    """A parallelogram that emits one channel, in panel pixels from the upper left corner of its
    cell, x right, y down.

    channel: 0 red, 1 green, 2 blue.
    across, down: its two edge vectors; (width, 0) and (0, height) make a rectangle.
    period: from one copy of it to the next along x and y, whole panel pixels.
    """

    channel: int
    centre: Vector
    across: Vector
    down: Vector
    period: tuple[int, int] = (1, 1)

    @property
    def area(self) -> float:
        """Area, in squared panel pixels."""
        return abs(self.across[0] * self.down[1] - self.across[1] * self.down[0])

    @property
    def density(self) -> float:
        """Share of the panel's area that its copies fill."""
        return self.area / (self.period[0] * self.period[1])

    @property
    def is_rectangle(self) -> bool:
        return self.across[1] == 0 and self.down[0] == 0

    @property
    def pixel(self) -> Vector:
        """Centre of the panel pixel whose value it shows: the one that its own centre lies in."""
        return math.floor(self.centre[0]) + 0.5, math.floor(self.centre[1]) + 0.5

    def corners(self) -> list[Vector]:
        """Return the four corners, in order around it."""
        (cx, cy), (ax, ay), (dx, dy) = self.centre, self.across, self.down
        turns = ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
        return [(cx + s * ax + t * dx, cy + s * ay + t * dy) for s, t in turns]

    def box(self) -> tuple[float, float, float, float]:
        """Return left, top, right and bottom of the smallest upright rectangle around it."""
        x, y = zip(*self.corners(), strict=True)
        return min(x), min(y), max(x), max(y)

    def moved(self, x: float, y: float) -> Subpixel:
        """Return it with its centre moved."""
        return replace(self, centre=(self.centre[0] + x, self.centre[1] + y))


def is_overlapping(a: Subpixel, b: Subpixel) -> bool:
    """Whether a subpixel and any copy of another share an area."""
    cells = itertools.product((-1, 0, 1), repeat=2)
    return any(_has_shared_area(a, b.moved(i * b.period[0], j * b.period[1])) for i, j in cells)


def _has_shared_area(a: Subpixel, b: Subpixel) -> bool:
    """Whether two parallelograms share an area: no edge of either separates them."""
    for axis in (a.across, a.down, b.across, b.down):
        normal = (-axis[1], axis[0])
        spans = []
        for subpixel in (a, b):
            along = [x * normal[0] + y * normal[1] for x, y in subpixel.corners()]
            spans.append((min(along), max(along)))
        (low_a, high_a), (low_b, high_b) = spans
        if high_a <= low_b + 1e-9 or high_b <= low_a + 1e-9:
            return False
    return True


def in_smallest_cell(subpixels: Sequence[Subpixel]) -> list[Subpixel]:
    """Return subpixels of one channel and one period as fewer ones, of the smallest period of whole
    panel pixels with which they repeat: in PenTile, green does so from pixel to pixel."""
    found = list(subpixels)
    for axis in (0, 1):
        whole = found[0].period[axis] if found else 1
        for period in range(1, whole):
            if whole % period == 0 and _is_periodic(found, axis, period):
                found = _in_cell(found, axis, period)
                break
    return found


def _is_periodic(subpixels: Sequence[Subpixel], axis: int, period: int) -> bool:
    """Whether every subpixel has a copy of itself `period` panel pixels along an axis, and is no
    longer than that: it would overlap its copies' cells."""
    step = (period, 0) if axis == 0 else (0, period)
    known = {_shape(subpixel) for subpixel in subpixels}
    for subpixel in subpixels:
        box = subpixel.box()
        if box[axis + 2] - box[axis] > period or _shape(subpixel.moved(*step)) not in known:
            return False
    return True


def _shape(subpixel: Subpixel) -> tuple[float, ...]:
    """Return numbers that are the same for a subpixel and its copies."""
    numbers = []
    for place, period in zip(subpixel.centre, subpixel.period, strict=True):
        numbers.append(round(place % period, MATCHING_DIGITS) % period)
    for edge in (*subpixel.across, *subpixel.down):
        numbers.append(round(edge, MATCHING_DIGITS))
    return tuple(numbers)


def _in_cell(subpixels: Sequence[Subpixel], axis: int, period: int) -> list[Subpixel]:
    """Return the subpixels in the first `period` panel pixels along an axis, which stand for the
    others."""
    kept = []
    for subpixel in subpixels:
        if _shape(subpixel)[axis] >= period:
            continue
        (x, y), (px, py) = subpixel.centre, subpixel.period
        if axis == 0:
            kept.append(replace(subpixel, centre=(x % px, y), period=(period, py)))
        else:
            kept.append(replace(subpixel, centre=(x, y % py), period=(px, period)))
    return kept
