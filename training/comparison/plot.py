"""The plot of robustness against training time: a point for each recipe, with its name."""

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from training.comparison.summaries import RecipeSummary, pareto
from training.report.plots import (
    BASELINE_COLOUR,
    GRID_COLOUR,
    MODEL_COLOUR,
    TEXT_COLOUR,
    png,
    style_axes,
)

SIZE_INCHES, DPI = (6.4, 7.4), 100  # 640 x 740 pixels, read on a phone, too
TITLE_WIDTH = 68  # characters of a line of the title
PANELS = {"worst_4": "noise up to 4/255", "worst_8": "noise up to 8/255"}
# looks of the recipes on the front and behind it, and the places of their names, off the interval
ON_FRONT: dict[str, Any] = {
    "label": "on it, with 95 % intervals",
    "fmt": "o",
    "markersize": 7,
    "color": MODEL_COLOUR,
}
BEHIND: dict[str, Any] = {
    "label": "behind it",
    "fmt": "D",
    "markersize": 6,
    "color": BASELINE_COLOUR,
    "markerfacecolor": "white",
}
ABOVE: dict[str, Any] = {"xytext": (0, 3), "verticalalignment": "bottom"}
BELOW: dict[str, Any] = {"xytext": (0, -3), "verticalalignment": "top"}


def draw(recipes: Sequence[RecipeSummary], shared: Mapping[str, Any]) -> bytes:
    """Return the figure as a PNG of 640 x 740 pixels."""
    return png(figure(recipes, shared))


def figure(recipes: Sequence[RecipeSummary], shared: Mapping[str, Any]) -> Figure:
    """Draw worst-case accuracy against the time of training, one panel a bound."""
    fig = Figure(figsize=SIZE_INCHES, dpi=DPI, layout="constrained", facecolor="white")
    panels = fig.subplots(len(PANELS), sharex=True)
    for ax, (rate, title) in zip(panels, PANELS.items(), strict=True):
        _draw_recipes(ax, recipes, rate)
        ax.set_title(title, size=11, color=TEXT_COLOUR, loc="left")
        style_axes(ax, "", "worst-case accuracy, %")
        ax.grid(axis="x", color=GRID_COLOUR, linewidth=0.7)
        ax.xaxis.set_major_locator(LogLocator(subs=(1, 1.5, 2, 3, 5)))
        ax.xaxis.set_minor_locator(NullLocator())
        ax.xaxis.set_major_formatter("{x:g}×")
    time = "training time, relative to plain training (log scale)"
    panels[-1].set_xlabel(time, size=10, color=TEXT_COLOUR)
    facts = "{data}, {model}, {scene}; n = {n}, {steps} steps, eps in {bound}".format(**shared)
    title = textwrap.fill(f"What robustness costs: {facts}", TITLE_WIDTH)
    fig.suptitle(title, size=11.5, color=TEXT_COLOUR, parse_math=False)
    handles, labels = panels[0].get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    look = {"frameon": False, "fontsize": 9, "labelcolor": TEXT_COLOUR}
    fig.legend(unique.values(), unique, loc="outside lower center", ncols=len(unique), **look)
    return fig


def _draw_recipes(ax: Axes, recipes: Sequence[RecipeSummary], rate: str) -> None:
    """Draw the Pareto front, and every recipe with its name and its intervals along both axes."""
    ax.set_xscale("log")
    ax.margins(x=0.12, y=0.12)  # names stand above and below the intervals
    places = [(recipe.relative_time.value, 100 * recipe.rates[rate].value) for recipe in recipes]
    fronts = pareto(places)
    front = {place for place, is_on_front in zip(places, fronts, strict=True) if is_on_front}
    line: dict[str, Any] = {"color": MODEL_COLOUR, "linewidth": 1.2, "alpha": 0.5}
    # between two recipes the cheaper one counts
    ax.step(*zip(*sorted(front), strict=True), where="post", label="Pareto front", **line)
    for recipe, (x, y), is_on_front in zip(recipes, places, fronts, strict=True):
        look = ON_FRONT if is_on_front else BEHIND
        left, right = np.abs(np.subtract(recipe.relative_time[1:], x))
        low, high = 100 * np.array(recipe.rates[rate][1:])
        ax.errorbar(x, y, yerr=[[y - low], [high - y]], xerr=[[left], [right]], **look)
        ax.update_datalim([(x / 1.2, y), (1.2 * x, y)])  # so that a point alone has ticks around it
        name = recipe.name + (" †" if recipe.collapsed_count else "")
        text: dict[str, Any] = {"size": 11, "color": TEXT_COLOUR, "parse_math": False}
        text |= {"horizontalalignment": "center", "textcoords": "offset points"}
        end, side = (high, ABOVE) if is_on_front else (low, BELOW)
        ax.annotate(name, (x, end), **text, **side)
    if any(recipe.collapsed_count for recipe in recipes):
        ax.plot([], [], " ", label="† collapsed in training")
