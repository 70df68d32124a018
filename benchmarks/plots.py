"""The picture of accuracy against time, a small one for each problem."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from benchmarks.measure import frontier

# Okabe and Ito (2008): told apart by every common kind of colour vision; the markers say the same
# in print
STYLE = {
    "point": ("#D55E00", "X"),
    "supersample": ("#0072B2", "o"),
    "spectral": ("#009E73", "D"),
    "reference": ("#E69F00", "^"),
    "before": ("#56B4E9", "v"),
    "box": ("#CC79A7", "s"),
    "one": ("#000000", "+"),
}
INK, GRID_COLOUR, LINE_COLOUR = "#222222", "#DDDDDD", "#999999"
COLUMNS = 3
FLOOR_LABEL = "below the brute force's own error"
FLOOR = {"color": "#F0E442", "alpha": 0.35, "linewidth": 0}
AUTO = {
    "marker": "o",
    "markersize": 15,
    "fillstyle": "none",
    "color": "black",
    "markeredgewidth": 1.8,
    "linewidth": 0,
}
FRONTIER = {"color": LINE_COLOUR, "linewidth": 1.2, "linestyle": (0, (4, 2)), "zorder": 1}


def accuracy_vs_time(found: Sequence[dict[str, Any]], path: Path) -> None:
    """Write error over time, both logarithmic, of every problem in `found`, the results of
    `accuracy_vs_time.solve`."""
    lines = math.ceil(len(found) / COLUMNS)
    figure = Figure(
        figsize=(11, 2.9 * lines + 1.0), dpi=110, layout="constrained", facecolor="white"
    )
    axes = figure.subplots(lines, COLUMNS, squeeze=False)
    for axis, result in zip(axes.flat, found, strict=False):
        draw(axis, result)
    for axis in axes.flat[len(found) :]:
        axis.set_axis_off()
    for axis in axes[:, 0]:
        axis.set_ylabel("RMSE of the raw reading,\n% of its mean", size=9, color=INK)
    for axis in axes.flat[max(0, len(found) - COLUMNS) : len(found)]:
        axis.set_xlabel("time of one image, ms", size=9, color=INK)
    legend(figure, found)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, pil_kwargs={"optimize": True})


def draw(axis: Axes, result: dict[str, Any]) -> None:
    """Draw one problem. A method's settings are joined by a thin line, quartiles of time are bars,
    the ring is auto."""
    floor = result["brute_force"]["error_left_percent"]
    families: dict[str, list[dict[str, Any]]] = {}
    for row in result["rows"]:
        families.setdefault(family(row["method"]), []).append(row)
    for name, rows in families.items():
        draw_family(axis, name, rows)
    draw_frontier(axis, result["rows"], floor)
    axis.set(xscale="log", yscale="log")
    for scale in (axis.xaxis, axis.yaxis):
        scale.set_major_locator(LogLocator(subs=(1.0,) if spans(scale) else (1.0, 2.0, 5.0)))
    axis.margins(0.12)
    if floor > 0:
        bottom = min(axis.get_ylim()[0], floor / 1.5)
        axis.axhspan(bottom, floor, **FLOOR, zorder=0)
        axis.set_ylim(bottom=bottom)
    axis.set_title(result["title"], size=9, color=INK, loc="left")
    finish_log_axes(axis)


def finish_log_axes(axis: Axes) -> None:
    """Label the ticks of two logarithmic axes, and draw the grid and the frame."""
    for scale in (axis.xaxis, axis.yaxis):
        scale.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
        scale.set_minor_formatter(NullFormatter())
    axis.grid(color=GRID_COLOUR, linewidth=0.6)
    axis.set_axisbelow(True)
    axis.tick_params(labelsize=8, labelcolor=INK, color=GRID_COLOUR, which="both")
    axis.spines[["top", "right"]].set_visible(False)
    axis.spines[:].set_color(LINE_COLOUR)


def draw_family(axis: Axes, name: str, rows: Sequence[dict[str, Any]]) -> None:
    """Draw one method in all its settings."""
    errors = [row["rmse_percent"] for row in rows]
    times, below, above = [], [], []
    for row in rows:
        seconds = row["seconds"]
        times.append(1e3 * seconds["median"])
        below.append(1e3 * (seconds["median"] - seconds["low"]))
        above.append(1e3 * (seconds["high"] - seconds["median"]))
    if name == "auto":
        axis.plot(times, errors, **AUTO, zorder=4)
        return
    colour, marker = STYLE[name]
    axis.errorbar(
        times,
        errors,
        xerr=[below, above],
        color=colour,
        marker=marker,
        markersize=6,
        linewidth=0.8,
        elinewidth=1.4,
        zorder=3,
    )


def draw_frontier(axis: Axes, rows: Sequence[dict[str, Any]], floor: float) -> None:
    """Draw the Pareto frontier; errors below the floor count as the floor."""
    points = [(1e3 * row["seconds"]["median"], row["rmse_percent"]) for row in rows]
    told_apart = [(time, max(error, floor)) for time, error in points]
    times, errors = zip(*[points[i] for i in frontier(told_apart)], strict=True)
    axis.step(times, errors, where="post", **FRONTIER)


def spans(scale: Axis) -> bool:
    """Return whether an axis spans more than two powers of ten, which are then labels enough."""
    low, high = scale.get_data_interval()
    return high > 100 * low


def family(method: str) -> str:
    """Return the method without its setting."""
    return method.partition(":")[0].partition(" ")[0]


def legend(figure: Figure, found: Sequence[dict[str, Any]]) -> None:
    tolerances = "tolerance 1/64, 1/512, 1/4096"
    labels = {
        "spectral": f"spectral by the engine, {tolerances}",
        "reference": f"spectral by the reference, {tolerances}",
        "before": f"spectral by an older version, {tolerances}",
        "supersample": "supersample, n = 2, 4, 8, 16",
        "point": "point",
        "box": "box",
        "one": "auto with one panel pixel a sensor pixel",
    }
    drawn = set()
    for result in found:
        drawn |= {family(row["method"]) for row in result["rows"]}
    handles = []
    for name, label in labels.items():
        if name in drawn:
            colour, marker = STYLE[name]
            width = 0.8 if "," in label else 0.0  # a line joins several settings
            line = Line2D([], [], color=colour, marker=marker, linewidth=width, label=label)
            handles.append(line)
    handles += [
        Line2D([], [], **(AUTO | {"markersize": 11}), label="what auto chooses"),
        Line2D([], [], **FRONTIER, label="Pareto frontier"),
        Line2D([], [], **(FLOOR | {"alpha": 0.6, "linewidth": 7}), label=FLOOR_LABEL),
    ]
    note = (
        "picture, panel layout, pitch in sensor pixels a panel pixel, view; bars span the "
        "quartiles of time"
    )
    legend_above(figure, handles, f"Each plot is one problem: {note}")


def legend_above(figure: Figure, handles: list[Line2D], title: str) -> None:
    """Draw a legend of three columns above a figure's plots, under a line that explains them."""
    figure.legend(
        handles=handles,
        loc="outside upper left",
        ncols=3,
        frameon=False,
        fontsize=9,
        labelcolor=INK,
        title=title,
        title_fontsize=9,
        alignment="left",
    )
