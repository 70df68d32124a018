"""The plot of robustness against training time: a point for each recipe, labelled where there is
room."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from moireaug.evaluation.report.plots import FAINT, INK, OURS, THEIRS
from training.summaries import Recipe, pareto

SIZE, DPI = (10.0, 4.9), 100  # inches: 1000 x 490 pixels
PANELS = {"worst_4": "noise up to 4/255", "worst_8": "noise up to 8/255"}
TICKS = (0.1, 0.2, 0.3, 0.5, 0.7, 1, 1.5, 2, 3, 4, 6, 8, 10, 15, 20, 30, 50, 100, 200, 500, 1000)
RIVALS = "#777777"


def draw(recipes: Sequence[Recipe], shared: Mapping[str, Any]) -> bytes:
    """Return the figure as a PNG of 1000 x 490 pixels."""
    file = io.BytesIO()
    figure(recipes, shared).savefig(file, format="png")
    return file.getvalue()


def figure(recipes: Sequence[Recipe], shared: Mapping[str, Any]) -> Figure:
    """Worst-case accuracy against training time relative to recipe `clean`, one panel a bound.

    Args:
        recipes: as `summarise` gives them. shared: data, model, scene, n and steps, for the title.
    """
    fig = Figure(figsize=SIZE, dpi=DPI, layout="constrained", facecolor="white")
    FigureCanvasAgg(fig)
    panels = fig.subplots(1, len(PANELS), sharex=True)
    for ax, (key, title) in zip(panels, PANELS.items(), strict=True):
        _points(ax, recipes, key)
        ax.set_title(title, size=11, color=INK, loc="left")
        _axes(ax, recipes, key)
        ax.set_xlabel(
            "training time with its start, relative to clean (log scale)", size=10, color=INK
        )
    panels[0].set_ylabel("accuracy at the worst attacker, %", size=10, color=INK)
    facts = "{data}, {model}, {scene}; n = {n}, {steps} steps an attack".format(**shared)
    fig.suptitle(f"What robustness costs: {facts}", size=11.5, color=INK, parse_math=False)
    handles, _ = panels[0].get_legend_handles_labels()
    fig.legend(
        handles=handles,
        loc="outside lower center",
        ncols=5,
        frameon=False,
        fontsize=9,
        labelcolor=INK,
    )
    fig.canvas.draw()
    fig.set_layout_engine("none")  # labels find their places among points that no longer move
    for ax, key in zip(panels, PANELS, strict=True):
        _label(ax, recipes, key)
    return fig


def _places(recipes: Sequence[Recipe], key: str) -> list[tuple[float, float]]:
    return [(r.relative.value, 100 * r.rates[key].value) for r in recipes]


def _points(ax: Axes, recipes: Sequence[Recipe], key: str) -> None:
    ax.set_xscale("log")
    places = _places(recipes, key)
    ax.plot(
        *zip(*_front(places), strict=True),
        color=OURS,
        linewidth=1.2,
        alpha=0.5,
        label="Pareto front",
    )
    looks = {True: ("o", OURS, OURS, "on it"), False: ("D", THEIRS, "white", "behind it")}
    for r, (x, y), front in zip(recipes, places, pareto(places), strict=True):
        marker, colour, fill, _ = looks[front]
        for along, e, scale in (("y", r.rates[key], 100), ("x", r.relative, 1)):
            ends = [scale * e.low, scale * e.high]
            pair = ([x, x], ends) if along == "y" else (ends, [y, y])
            ax.plot(
                *pair,
                color=colour,
                linewidth=1.6 if along == "y" else 1.0,
                alpha=0.55,
                solid_capstyle="butt",
            )
        ax.plot(
            [x],
            [y],
            marker,
            color=colour,
            markerfacecolor=fill,
            markersize=7 if front else 6,
            zorder=3,
        )
    for marker, colour, fill, name in looks.values():
        ax.plot([], [], marker, color=colour, markerfacecolor=fill, label=name)
    ax.plot([], [], "|", color=RIVALS, markersize=13, markeredgewidth=1.6, label="95 % interval")
    if any(r.collapsed for r in recipes):
        ax.plot([], [], " ", label="† collapsed in training")


def _front(places: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the Pareto front as steps: between two recipes the cheaper one is what there is."""
    line = sorted({place for place, front in zip(places, pareto(places), strict=True) if front})
    steps = [corner for (_, y), (x, top) in pairwise(line) for corner in ((x, y), (x, top))]
    return [line[0], *steps]


def _axes(ax: Axes, recipes: Sequence[Recipe], key: str) -> None:
    left, right = min(r.relative.low for r in recipes), max(r.relative.high for r in recipes)
    left = max(
        left, 0.2 * min(r.relative.value for r in recipes)
    )  # two seeds may leave an interval down to 0
    low, high = (
        min(100 * r.rates[key].low for r in recipes),
        max(100 * r.rates[key].high for r in recipes),
    )
    margin, wide = max(2.0, 0.08 * (high - low)), max(math.log(right / left), math.log(1.5))
    left, right = (
        left * math.exp(-0.1 * wide),
        right * math.exp(0.28 * wide),
    )  # a name may stand at the right
    ax.set(xlim=(left, right), ylim=(max(-margin / 2, low - margin), min(102.0, high + margin)))
    inside = [t for t in TICKS if left <= t <= right]
    ticks = inside[:: -(-len(inside) // 8)]
    ax.set_xticks(ticks, [f"{t:g}×" for t in ticks])
    ax.xaxis.set_minor_locator(NullLocator())
    ax.tick_params(labelsize=9.5, labelcolor=INK, color=FAINT)
    ax.grid(color=FAINT, linewidth=0.7)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[:].set_color("#999999")


def _label(ax: Axes, recipes: Sequence[Recipe], key: str) -> None:
    """Put a name beside each point, at the nearest place that is free of points, intervals and
    other names."""
    frame, places = np.array(ax.get_window_extent().extents), _places(recipes, key)
    renderer = ax.figure.canvas.get_renderer()  # type: ignore[attr-defined]
    pixels, data = ax.transData.transform, ax.transData.inverted().transform
    taken = [np.array([x - 6, y - 6, x + 6, y + 6]) for x, y in pixels(places)]
    taken += _thick(pixels(_front(places)))
    for r, (x, y) in zip(recipes, places, strict=True):
        taken += _thick(pixels([(x, 100 * r.rates[key].low), (x, 100 * r.rates[key].high)]))
        taken += _thick(pixels([(max(r.relative.low, 1e-9), y), (r.relative.high, y)]))
    for r, point in sorted(zip(recipes, pixels(places), strict=True), key=lambda pair: -pair[1][1]):
        text = ax.text(
            0,
            0,
            r.name + (" †" if r.collapsed else ""),
            size=9.5,
            color=INK,
            parse_math=False,
            zorder=4,
        )
        extent = text.get_window_extent(renderer)
        boxes = [
            np.concatenate([point, point]) + box for box in _around(extent.width, extent.height)
        ]
        best = min(boxes, key=lambda box: _cost(box, point, np.array(taken), frame))
        taken.append(best)
        left, bottom = data(best[:2])
        text.set_position((left, bottom))
        end = np.clip(point, best[:2], best[2:])
        if np.hypot(*(end - point)) > 20:
            ax.plot(*data([point, end]).T, color=RIVALS, linewidth=0.7)
            taken += _thick(
                point + np.linspace(0, 1, 12)[:, None] * (end - point)
            )  # other lines keep clear of it


def _thick(line: np.ndarray) -> list[np.ndarray]:
    """Return the upright and lying pieces of a line, as boxes (left, bottom, right, top) of some
    pixels."""
    return [
        np.concatenate([np.minimum(a, b) - 1.5, np.maximum(a, b) + 1.5]) for a, b in pairwise(line)
    ]


def _around(width: float, height: float) -> list[np.ndarray]:
    """Boxes for a name around a point at the origin, in pixels."""
    corners = []
    for gap in range(9, 130, 6):
        near = 0.7 * gap
        corners += [(x, y) for x in (near, -near - width) for y in (near, -near - height)]
        corners += [(x, -height / 2) for x in (gap, -gap - width)]
        corners += [(x, y) for x in (-width, -width / 2, 0) for y in (gap, -gap - height)]
    return [np.array([x, y, x + width, y + height]) for x, y in corners]


def _cost(box: np.ndarray, point: np.ndarray, taken: np.ndarray, frame: np.ndarray) -> float:
    """How bad a place for a name is: what it covers, what sticks out of the panel, how far its
    point is, and what lies between the two."""
    end = np.clip(point, box[:2], box[2:])
    between = point + np.linspace(0, 1, 16)[:, None] * (end - point)
    between = between[np.hypot(*(between - point).T) > 9, None]
    crossed = ((between >= taken[:, :2] - 1) & (between <= taken[:, 2:] + 1)).all(2).any(1).sum()
    outside = np.prod(box[2:] - box[:2]) - _shared(box, frame[None])
    return 5 * _shared(box, taken) + 20 * outside + np.hypot(*(end - point)) + 8 * crossed


def _shared(box: np.ndarray, others: np.ndarray) -> float:
    """Area that a box has in common with others."""
    sides = np.minimum(box[2:], others[:, 2:]) - np.maximum(box[:2], others[:, :2])
    return float(np.clip(sides, 0, None).prod(1).sum())
