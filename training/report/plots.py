"""The plots of a run, as SVG: its training, and how visible noise is. Other rates are drawn by the
page itself, in its tables.

The colours are Okabe and Ito's (2008), told apart by every common kind of colour vision; in print
the markers' shapes say the same. The background is transparent: in dark mode the page inverts the
lightness of a plot and keeps its hues.
"""

import io
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from training.report.page import uri

MODEL_COLOUR, BASELINE_COLOUR = "#0072B2", "#D55E00"  # this model, the baseline
TEXT_COLOUR, GRID_COLOUR = "#222222", "#DDDDDD"
FIGURE_INCHES = (4.6, 3.3)  # readable on a phone, and two abreast on a page
MARKERS = ((MODEL_COLOUR, "o"), (BASELINE_COLOUR, "D"))
LINES = ("-", (0, (3, 1.5)))  # solid, dashed


class History(NamedTuple):
    """The history of a training.

    Args:
        x: epochs, or steps, of its rows.
        rows: figures by name; one that was not measured is missing.
        best: epoch or step of the weights that were kept.
    """

    x: Sequence[float]
    rows: Sequence[Mapping[str, float]]
    best: float


class Quantity(NamedTuple):
    """A quantity to plot.

    Args:
        title: title of the y axis, with its unit.
        series: names of one or two figures of a row, and what the legend calls them; "" where
            there is but one.
        limits: ends of the y axis; None for those of the data.
    """

    title: str
    caption: str
    series: Mapping[str, str]
    scale: float = 1.0
    limits: tuple[float | None, float | None] = (None, None)


class Series(NamedTuple):
    """Points of a plot that belong together.

    Args:
        points: x, y, and the low and high end of an interval of y, each.
        model: index of the model, 0 for this one and 1 for its baseline, which gives the colour.
        filled: whether its markers are filled, and its points joined by a line.
    """

    name: str
    points: Sequence[tuple[float, float, float, float]]
    model: int
    filled: bool


def scatter(series: Sequence[Series], x: str, y: str) -> dict[str, str] | None:
    """Draw points with their intervals along y, rates in [0, 1] drawn in percent; return the plot
    with its alternative text, None without points."""
    if not series:
        return None
    figure = Figure(FIGURE_INCHES, layout="constrained")
    ax = figure.subplots()
    for one in series:
        colour, marker = MARKERS[one.model]
        style: dict[str, Any] = {"color": colour, "marker": marker, "markersize": 6, "capsize": 2}
        style |= {"linestyle": "-" if one.filled else "none", "label": one.name}
        style |= {"markerfacecolor": colour if one.filled else "white", "clip_on": False}
        xs, rates, low, high = np.array(sorted(one.points)).T
        below, above = np.abs(rates - low), np.abs(high - rates)
        ax.errorbar(xs, 100 * rates, yerr=100 * np.stack([below, above]), **style)
    ax.set_ylim(0, 100)
    style_axes(ax, x, y)
    alt = f"{y} against {x}: {', '.join(one.name for one in series)}"
    _add_legend(ax)
    data = uri(svg(figure).encode(), "image/svg+xml")
    return {"uri": data, "alt": alt}


def curves(
    histories: Mapping[str, History], x: str, quantities: Sequence[Quantity]
) -> list[dict[str, str]]:
    """Draw quantities against the epoch or step: a plot each, with caption and alternative text.

    Args:
        histories: histories of this model, and of the baseline after it, by name; the name may be
            "" where there is but one.
    """
    plots = []
    for quantity in quantities:
        figure = Figure(FIGURE_INCHES, layout="constrained")
        ax = figure.subplots()
        for (name, history), (colour, marker) in zip(histories.items(), MARKERS, strict=False):
            for (key, kind), line in zip(quantity.series.items(), LINES, strict=False):
                style: dict[str, Any] = {"marker": marker, "markersize": 3.2, "linestyle": line}
                style |= {"color": colour, "label": ": ".join(filter(None, (name, kind)))}
                _draw(ax, history, key, quantity.scale, style)
        ax.set_ylim(*quantity.limits)
        ax.xaxis.set_major_locator(MaxNLocator(7, integer=True))  # epochs or steps
        style_axes(ax, x, quantity.title)
        alt = f"{quantity.title} against the {x}"
        labels = _add_legend(ax)
        if labels:
            alt += f", a line for {' and '.join(labels)}"
        data = uri(svg(figure).encode(), "image/svg+xml")
        plots.append({"uri": data, "alt": alt, "caption": quantity.caption})
    return plots


def _add_legend(ax: Axes) -> list[str]:
    """Add a legend of what has a label, and return the labels."""
    handles, labels = ax.get_legend_handles_labels()
    if handles:
        legend = ax.legend(handles, labels, frameon=False, fontsize=9, labelcolor=TEXT_COLOUR)
        for text in legend.get_texts():
            text.set_parse_math(False)  # a recipe may have a dollar sign in its name
    return labels


def _draw(ax: Axes, history: History, key: str, scale: float, style: Mapping[str, Any]) -> None:
    """Draw a figure of a history, with a ring around that of the weights that were kept."""
    points = []
    for x, row in zip(history.x, history.rows, strict=True):
        if key in row:
            points.append((x, scale * row[key]))
    if points:
        ax.plot(*zip(*points, strict=True), **style)
    for x, y in points:
        if x == history.best:
            ax.plot(x, y, "o", color=style["color"], markersize=10, fillstyle="none", clip_on=False)


def style_axes(ax: Axes, x_title: str, y_title: str) -> None:
    """Label the axes, and draw them faintly."""
    ax.set_xlabel(x_title, size=10, color=TEXT_COLOUR)
    ax.set_ylabel(y_title, size=10, color=TEXT_COLOUR)
    ax.tick_params(labelsize=9.5, labelcolor=TEXT_COLOUR, color=GRID_COLOUR)
    ax.grid(axis="y", color=GRID_COLOUR, linewidth=0.7)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[:].set_color("#999999")


def png(figure: Figure) -> bytes:
    """Return the figure as PNG."""
    file = io.BytesIO()
    figure.savefig(file, format="png")
    return file.getvalue()


def svg(figure: Figure) -> str:
    """Return the figure as SVG, its letters as outlines, so that it looks the same where a font is
    missing."""
    file = io.StringIO()
    figure.savefig(file, format="svg", metadata={"Date": None}, transparent=True)
    return file.getvalue()
