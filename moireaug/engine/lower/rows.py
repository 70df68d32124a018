"""Records image by image. Records are named tuples of values and arrays: those of a shot's images
have a row for each, and the others depend on its scene and size alone."""

from __future__ import annotations

from typing import Any

import numpy as np


def changed_rows(start: Any, moved: Any) -> np.ndarray:
    """Return which images have other records than those that they were moved from, (m * B,) bool.

    Args:
        start: records of B images.
        moved: records of the same images, m > 1 times.
    """
    changed: Any = False
    for a, b in zip(start, moved, strict=True):
        if isinstance(a, tuple):
            changed = changed | changed_rows(a, b)
        elif _has_rows(a, b):
            same = np.tile(a, (len(b) // len(a), *[1] * (a.ndim - 1)))
            changed = changed | (b != same).any(tuple(range(1, a.ndim)))
    return changed


def rows_of(records: Any, others: Any, rows: np.ndarray) -> Any:
    """Return the records of some images; others: records of another number of images of the same
    scene and size."""
    taken = []
    for a, b in zip(records, others, strict=True):
        if isinstance(a, tuple):
            a = rows_of(a, b, rows)
        elif _has_rows(a, b):
            a = np.ascontiguousarray(a[rows])
        taken.append(a)
    return type(records)(*taken) if hasattr(records, "_fields") else tuple(taken)


def _has_rows(a: Any, b: Any) -> bool:
    """Return whether a record's value is an array with a row for each image, from its values of
    two numbers of images."""
    return isinstance(a, np.ndarray) and a.shape != b.shape
