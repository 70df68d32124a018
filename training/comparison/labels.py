"""Names beside the points of a plot, each at the nearest place that is free."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes

from training.report.plots import TEXT_COLOUR

LEADER_COLOUR = "#777777"  # of the lines that join points and names
MAX_GAP_PIXELS = 20  # from a point to its name, beyond which a line joins them
Place = tuple[float, float]


def label_points(
    ax: Axes, names: Sequence[str], places: Sequence[Place], lines: Sequence[Sequence[Place]]
) -> None:
    """Put a name beside each point, at the nearest place that is free of points, lines and other
    names.

    Args:
        ax: panel of the points, whose limits no longer change.
        names: names of the points.
        places: places of the points, in data coordinates.
        lines: lines that names must not cover, in data coordinates.
    """
    frame = np.array(ax.get_window_extent().extents)
    renderer = ax.figure.canvas.get_renderer()  # type: ignore[attr-defined]
    pixels, data = ax.transData.transform, ax.transData.inverted().transform
    points = pixels(places)
    covered = [np.array([x - 6, y - 6, x + 6, y + 6]) for x, y in points]
    for line in lines:
        covered += _boxes_of_line(pixels(line))
    by_height = sorted(zip(names, points, strict=True), key=lambda pair: -pair[1][1])
    for name, point in by_height:
        text = ax.text(0, 0, name, size=9.5, color=TEXT_COLOUR, parse_math=False, zorder=4)
        extent = text.get_window_extent(renderer)
        at_point = np.concatenate([point, point])
        boxes = [at_point + box for box in _boxes_around(extent.width, extent.height)]
        others = points[(points != point).any(1)]
        costs = [_cost(box, point, others, np.array(covered), frame) for box in boxes]
        best = boxes[int(np.argmin(costs))]
        covered.append(best + np.array([-6, -1, 6, 1]))  # names side by side would read as one
        left, bottom = data(best[:2])
        text.set_position((left, bottom))
        end = np.clip(point, best[:2], best[2:])
        if np.hypot(*(end - point)) > MAX_GAP_PIXELS:
            ax.plot(*data([point, end]).T, color=LEADER_COLOUR, linewidth=0.7)
            # other lines keep clear of this one
            covered += _boxes_of_line(point + np.linspace(0, 1, 12)[:, None] * (end - point))


def _boxes_of_line(line: np.ndarray) -> list[np.ndarray]:
    """Return the vertical and horizontal pieces of a line, as boxes (left, bottom, right, top) a
    few pixels wide."""
    boxes = []
    for start, end in pairwise(line):
        low, high = np.minimum(start, end) - 1.5, np.maximum(start, end) + 1.5
        boxes.append(np.concatenate([low, high]))
    return boxes


def _boxes_around(width: float, height: float) -> list[np.ndarray]:
    """Return boxes for a name around a point at the origin, in pixels."""
    corners: list[tuple[float, float]] = []
    for gap in range(9, 130, 6):
        near = 0.7 * gap
        for x in (near, -near - width):
            corners += [(x, near), (x, -near - height)]
        for x in (gap, -gap - width):
            corners.append((x, -height / 2))
        for x in (-width, -width / 2, 0):
            corners += [(x, gap), (x, -gap - height)]
    return [np.array([x, y, x + width, y + height]) for x, y in corners]


def _cost(
    box: np.ndarray, point: np.ndarray, others: np.ndarray, covered: np.ndarray, frame: np.ndarray
) -> float:
    """Return the cost of a place for a name: the area that it covers or that is outside the panel,
    its distance from the point, the boxes between the two, and whether the name seems to be another
    point's."""
    end = np.clip(point, box[:2], box[2:])
    between = point + np.linspace(0, 1, 16)[:, None] * (end - point)
    between = between[np.hypot(*(between - point).T) > 9, None]
    inside = (between >= covered[:, :2] - 1) & (between <= covered[:, 2:] + 1)
    crossed = inside.all(2).any(1).sum()
    outside = np.prod(box[2:] - box[:2]) - _shared_area(box, frame[None])
    distance = np.hypot(*(end - point))
    ends = np.clip(others, box[:2], box[2:])
    is_ambiguous = (np.hypot(*(ends - others).T) < distance + 4).any()
    covered_area = _shared_area(box, covered)
    return 5 * covered_area + 20 * outside + distance + 8 * crossed + 60 * is_ambiguous


def _shared_area(box: np.ndarray, others: np.ndarray) -> float:
    """Return the area that a box has in common with others."""
    sides = np.minimum(box[2:], others[:, 2:]) - np.maximum(box[:2], others[:, :2])
    return float(np.clip(sides, 0, None).prod(1).sum())
