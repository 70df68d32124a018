"""The plot of robustness against training time: a point for each recipe, labelled where there is
room."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullLocator

from training.comparison.labels import LEADER_COLOUR, Place, label_points
from training.comparison.summaries import RecipeSummary, pareto
from training.report.plots import BASELINE_COLOUR, GRID_COLOUR, MODEL_COLOUR, TEXT_COLOUR

SIZE_INCHES, DPI = (10.0, 4.9), 100  # 1000 x 490 pixels
PANELS = {"worst_4": "noise up to 4/255", "worst_8": "noise up to 8/255"}
TICKS = (0.1, 0.2, 0.3, 0.5, 0.7, 1, 1.5, 2, 3, 4, 6, 8, 10, 15, 20, 30, 50, 100, 200, 500, 1000)
MIN_TICKS, MAX_TICKS = 2, 8


class MarkerLook(NamedTuple):
    """The look of recipes on the front, or behind it."""

    name: str
    marker: str
    size: int
    colour: str
    fill: str

    def colours(self) -> dict[str, Any]:
        """Return the colours of a marker, as matplotlib's settings."""
        return {"color": self.colour, "markerfacecolor": self.fill}


ON_FRONT = MarkerLook("on it", "o", 7, MODEL_COLOUR, MODEL_COLOUR)
BEHIND = MarkerLook("behind it", "D", 6, BASELINE_COLOUR, "white")


def draw(recipes: Sequence[RecipeSummary], shared: Mapping[str, Any]) -> bytes:
    """Return the figure as a PNG of 1000 x 490 pixels."""
    file = io.BytesIO()
    figure(recipes, shared).savefig(file, format="png")
    return file.getvalue()


def figure(recipes: Sequence[RecipeSummary], shared: Mapping[str, Any]) -> Figure:
    """Draw worst-case accuracy against training time relative to plain training, one panel a bound.

    Args:
        recipes: recipes, as `summarise` returns them.
        shared: data, model, scene, n and steps, for the title.
    """
    fig = Figure(figsize=SIZE_INCHES, dpi=DPI, layout="constrained", facecolor="white")
    FigureCanvasAgg(fig)
    panels = fig.subplots(1, len(PANELS), sharex=True)
    for ax, (key, title) in zip(panels, PANELS.items(), strict=True):
        _draw_points(ax, recipes, key)
        ax.set_title(title, size=11, color=TEXT_COLOUR, loc="left")
        _draw_axes(ax, recipes, key)
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


def _places(recipes: Sequence[RecipeSummary], key: str) -> list[Place]:
    return [(r.relative.value, 100 * r.rates[key].value) for r in recipes]


def _draw_points(ax: Axes, recipes: Sequence[RecipeSummary], key: str) -> None:
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
    ax.plot(
        [], [], "|", color=LEADER_COLOUR, markersize=13, markeredgewidth=1.6, label="95 % interval"
    )
    if any(recipe.collapsed for recipe in recipes):
        ax.plot([], [], " ", label="† collapsed in training")


def _front(places: Sequence[Place]) -> list[Place]:
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


def _draw_axes(ax: Axes, recipes: Sequence[RecipeSummary], key: str) -> None:
    ax.set(xlim=_cost_limits(recipes), ylim=_accuracy_limits(recipes, key))
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
    if len(inside) < MIN_TICKS:
        evenly = MaxNLocator(MAX_TICKS // 2).tick_values(left, right)
        inside = [float(tick) for tick in evenly if left <= tick <= right]
    return inside[:: math.ceil(len(inside) / MAX_TICKS)]


def _cost_limits(recipes: Sequence[RecipeSummary]) -> tuple[float, float]:
    """Return the ends of the axis of costs: a name may stand to the right of the last point."""
    lowest = min(recipe.relative.low for recipe in recipes)
    cheapest = min(recipe.relative.value for recipe in recipes)
    left = max(lowest, 0.2 * cheapest)  # two seeds may leave an interval down to 0
    right = max(recipe.relative.high for recipe in recipes)
    wide = max(math.log(right / left), math.log(1.5))
    return left * math.exp(-0.1 * wide), right * math.exp(0.28 * wide)


def _accuracy_limits(recipes: Sequence[RecipeSummary], key: str) -> tuple[float, float]:
    """Return the ends of the axis of accuracies, in percent."""
    low = min(100 * recipe.rates[key].low for recipe in recipes)
    high = max(100 * recipe.rates[key].high for recipe in recipes)
    margin = max(2.0, 0.08 * (high - low))
    return max(-margin / 2, low - margin), min(102.0, high + margin)


def _label(ax: Axes, recipes: Sequence[RecipeSummary], key: str) -> None:
    """Name the points, clear of the front and of all intervals."""
    places = _places(recipes, key)
    names = [recipe.name + (" †" if recipe.collapsed else "") for recipe in recipes]
    lines: list[list[Place]] = [_front(places)]
    for recipe, (x, y) in zip(recipes, places, strict=True):
        rate, cost = recipe.rates[key], recipe.relative
        lines.append([(x, 100 * rate.low), (x, 100 * rate.high)])
        lines.append([(max(cost.low, 1e-9), y), (cost.high, y)])
    label_points(ax, names, places, lines)
