"""The plot of robustness against training time: a point for each recipe, labelled where there is
room."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullLocator

from moireaug.evaluation.report.plots import BASELINE_COLOUR, GRID_COLOUR, MODEL_COLOUR, TEXT_COLOUR
from training.comparison.summaries import Recipe, pareto

SIZE, DPI = (10.0, 4.9), 100  # inches: 1000 x 490 pixels
PANELS = {"worst_4": "noise up to 4/255", "worst_8": "noise up to 8/255"}
TICKS = (0.1, 0.2, 0.3, 0.5, 0.7, 1, 1.5, 2, 3, 4, 6, 8, 10, 15, 20, 30, 50, 100, 200, 500, 1000)
RIVALS = "#777777"
FEWEST_TICKS, MOST_TICKS = 2, 8
FAR = 20  # pixels from a point to its name, beyond which a line joins them


class Look(NamedTuple):
    """How recipes on the front, or behind it, are drawn."""

    name: str
    marker: str
    size: int
    colour: str
    fill: str

    def colours(self) -> dict[str, Any]:
        """Return the settings of a marker."""
        return {"color": self.colour, "markerfacecolor": self.fill}


ON_FRONT = Look("on it", "o", 7, MODEL_COLOUR, MODEL_COLOUR)
BEHIND = Look("behind it", "D", 6, BASELINE_COLOUR, "white")


def draw(recipes: Sequence[Recipe], shared: Mapping[str, Any]) -> bytes:
    """Return the figure as a PNG of 1000 x 490 pixels."""
    file = io.BytesIO()
    figure(recipes, shared).savefig(file, format="png")
    return file.getvalue()


def figure(recipes: Sequence[Recipe], shared: Mapping[str, Any]) -> Figure:
    """Draw worst-case accuracy against training time relative to plain training, one panel a bound.

    Args:
        recipes: as `summarise` gives them. shared: data, model, scene, n and steps, for the title.
    """
    fig = Figure(figsize=SIZE, dpi=DPI, layout="constrained", facecolor="white")
    FigureCanvasAgg(fig)
    panels = fig.subplots(1, len(PANELS), sharex=True)
    for ax, (key, title) in zip(panels, PANELS.items(), strict=True):
        _points(ax, recipes, key)
        ax.set_title(title, size=11, color=TEXT_COLOUR, loc="left")
        _axes(ax, recipes, key)
        ax.set_xlabel(
            "training time, relative to plain training (log scale)", size=10, color=TEXT_COLOUR
        )
    panels[0].set_ylabel("accuracy at the worst attacker, %", size=10, color=TEXT_COLOUR)
    facts = "{data}, {model}, {scene}; n = {n}, {steps} steps per attack".format(**shared)
    fig.suptitle(f"What robustness costs: {facts}", size=11.5, color=TEXT_COLOUR, parse_math=False)
    handles, _ = panels[0].get_legend_handles_labels()
    fig.legend(
        handles=handles,
        loc="outside lower center",
        ncols=5,
        frameon=False,
        fontsize=9,
        labelcolor=TEXT_COLOUR,
    )
    fig.canvas.draw()
    fig.set_layout_engine("none")  # labels find their places among points that no longer move
    for ax, key in zip(panels, PANELS, strict=True):
        _label(ax, recipes, key)
    return fig


def _places(recipes: Sequence[Recipe], key: str) -> list[tuple[float, float]]:
    return [(r.relative.value, 100 * r.rates[key].value) for r in recipes]


def _points(ax: Axes, recipes: Sequence[Recipe], key: str) -> None:
    """Draw the Pareto front, and every recipe with its intervals along both axes."""
    ax.set_xscale("log")
    places = _places(recipes, key)
    corners = zip(*_front(places), strict=True)
    ax.plot(*corners, color=MODEL_COLOUR, linewidth=1.2, alpha=0.5, label="Pareto front")
    for recipe, (x, y), front in zip(recipes, places, pareto(places), strict=True):
        look = ON_FRONT if front else BEHIND
        interval: dict[str, Any] = {
            "color": look.colour,
            "alpha": 0.55,
            "solid_capstyle": "butt",
        }
        rate, cost = recipe.rates[key], recipe.relative
        ax.plot([x, x], [100 * rate.low, 100 * rate.high], linewidth=1.6, **interval)
        ax.plot([cost.low, cost.high], [y, y], linewidth=1.0, **interval)
        ax.plot([x], [y], look.marker, markersize=look.size, zorder=3, **look.colours())
    for look in (ON_FRONT, BEHIND):
        ax.plot([], [], look.marker, label=look.name, **look.colours())
    ax.plot([], [], "|", color=RIVALS, markersize=13, markeredgewidth=1.6, label="95 % interval")
    if any(recipe.collapsed for recipe in recipes):
        ax.plot([], [], " ", label="† collapsed in training")


def _front(places: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the Pareto front as steps: between two recipes the cheaper one counts."""
    on_front = set()
    for place, front in zip(places, pareto(places), strict=True):
        if front:
            on_front.add(place)
    line = sorted(on_front)
    steps = [line[0]]
    for (_, y), (x, top) in pairwise(line):
        steps += [(x, y), (x, top)]
    return steps


def _axes(ax: Axes, recipes: Sequence[Recipe], key: str) -> None:
    ax.set(xlim=_costs(recipes), ylim=_accuracies(recipes, key))
    left, right = ax.get_xlim()
    ticks = _ticks(left, right)
    ax.set_xticks(ticks, [f"{tick:g}×" for tick in ticks])
    ax.xaxis.set_minor_locator(NullLocator())
    ax.tick_params(labelsize=9.5, labelcolor=TEXT_COLOUR, color=GRID_COLOUR)
    ax.grid(color=GRID_COLOUR, linewidth=0.7)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[:].set_color("#999999")


def _ticks(left: float, right: float) -> list[float]:
    """Return round numbers between two ends, of which there are few where recipes cost alike."""
    inside = [tick for tick in TICKS if left <= tick <= right]
    if len(inside) < FEWEST_TICKS:
        evenly = MaxNLocator(MOST_TICKS // 2).tick_values(left, right)
        inside = [float(tick) for tick in evenly if left <= tick <= right]
    return inside[:: math.ceil(len(inside) / MOST_TICKS)]


def _costs(recipes: Sequence[Recipe]) -> tuple[float, float]:
    """Return the ends of the axis of costs: a name may stand to the right of the last point."""
    lowest = min(recipe.relative.low for recipe in recipes)
    cheapest = min(recipe.relative.value for recipe in recipes)
    left = max(lowest, 0.2 * cheapest)  # two seeds may leave an interval down to 0
    right = max(recipe.relative.high for recipe in recipes)
    wide = max(math.log(right / left), math.log(1.5))
    return left * math.exp(-0.1 * wide), right * math.exp(0.28 * wide)


def _accuracies(recipes: Sequence[Recipe], key: str) -> tuple[float, float]:
    """Return the ends of the axis of accuracies, in percent."""
    low = min(100 * recipe.rates[key].low for recipe in recipes)
    high = max(100 * recipe.rates[key].high for recipe in recipes)
    margin = max(2.0, 0.08 * (high - low))
    return max(-margin / 2, low - margin), min(102.0, high + margin)


def _label(ax: Axes, recipes: Sequence[Recipe], key: str) -> None:
    """Put a name beside each point, at the nearest place that is free of points, intervals and
    other names."""
    frame = np.array(ax.get_window_extent().extents)
    renderer = ax.figure.canvas.get_renderer()  # type: ignore[attr-defined]
    pixels, data = ax.transData.transform, ax.transData.inverted().transform
    places = _places(recipes, key)
    points = pixels(places)
    taken = _drawn(ax, recipes, key)
    by_height = sorted(zip(recipes, points, strict=True), key=lambda pair: -pair[1][1])
    for recipe, point in by_height:
        name = recipe.name + (" †" if recipe.collapsed else "")
        text = ax.text(0, 0, name, size=9.5, color=TEXT_COLOUR, parse_math=False, zorder=4)
        extent = text.get_window_extent(renderer)
        at_point = np.concatenate([point, point])
        boxes = [at_point + box for box in _around(extent.width, extent.height)]
        others = points[(points != point).any(1)]
        costs = [_cost(box, point, others, np.array(taken), frame) for box in boxes]
        best = boxes[int(np.argmin(costs))]
        taken.append(best + np.array([-6, -1, 6, 1]))  # names side by side would read as one
        left, bottom = data(best[:2])
        text.set_position((left, bottom))
        end = np.clip(point, best[:2], best[2:])
        if np.hypot(*(end - point)) > FAR:
            ax.plot(*data([point, end]).T, color=RIVALS, linewidth=0.7)
            # other lines keep clear of this one
            taken += _thick(point + np.linspace(0, 1, 12)[:, None] * (end - point))


def _drawn(ax: Axes, recipes: Sequence[Recipe], key: str) -> list[np.ndarray]:
    """Return what names must not cover, as boxes in pixels: points, the front, intervals."""
    pixels = ax.transData.transform
    places = _places(recipes, key)
    taken = [np.array([x - 6, y - 6, x + 6, y + 6]) for x, y in pixels(places)]
    taken += _thick(pixels(_front(places)))
    for recipe, (x, y) in zip(recipes, places, strict=True):
        rate, cost = recipe.rates[key], recipe.relative
        taken += _thick(pixels([(x, 100 * rate.low), (x, 100 * rate.high)]))
        taken += _thick(pixels([(max(cost.low, 1e-9), y), (cost.high, y)]))
    return taken


def _thick(line: np.ndarray) -> list[np.ndarray]:
    """Return the vertical and horizontal pieces of a line, as boxes (left, bottom, right, top) a
    few pixels wide."""
    boxes = []
    for start, end in pairwise(line):
        low, high = np.minimum(start, end) - 1.5, np.maximum(start, end) + 1.5
        boxes.append(np.concatenate([low, high]))
    return boxes


def _around(width: float, height: float) -> list[np.ndarray]:
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
    box: np.ndarray, point: np.ndarray, others: np.ndarray, taken: np.ndarray, frame: np.ndarray
) -> float:
    """Return how bad a place for a name is: what it covers, what sticks out of the panel, how far
    its point is, what lies between the two, and whether the name seems to be another point's."""
    end = np.clip(point, box[:2], box[2:])
    between = point + np.linspace(0, 1, 16)[:, None] * (end - point)
    between = between[np.hypot(*(between - point).T) > 9, None]
    crossed = ((between >= taken[:, :2] - 1) & (between <= taken[:, 2:] + 1)).all(2).any(1).sum()
    outside = np.prod(box[2:] - box[:2]) - _shared(box, frame[None])
    away = np.hypot(*(end - point))
    ends = np.clip(others, box[:2], box[2:])
    taken_for = (np.hypot(*(ends - others).T) < away + 4).any()
    return 5 * _shared(box, taken) + 20 * outside + away + 8 * crossed + 60 * taken_for


def _shared(box: np.ndarray, others: np.ndarray) -> float:
    """Return the area that a box has in common with others."""
    sides = np.minimum(box[2:], others[:, 2:]) - np.maximum(box[:2], others[:, :2])
    return float(np.clip(sides, 0, None).prod(1).sum())
