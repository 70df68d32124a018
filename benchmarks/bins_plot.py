"""The picture of binned readings: error against time, full and binned, a plot for each number of
sensor pixels a photo pixel."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator

from benchmarks.plots import INK, LINE_COLOUR, finish_log_axes, legend_above

COLUMNS = 3
STYLE = {"full": ("#0072B2", "o"), "binned": ("#D55E00", "D")}  # told apart in print, too
SIZES = (9, 6.5, 4.5)  # of markers, from the finest tolerance on
MOIRE_LINE: dict[str, Any] = {"color": LINE_COLOUR, "linestyle": (0, (4, 2))}
MIN_DRAWN_ERROR = 1e-3  # codes: errors below are drawn there, on a logarithmic axis


def draw(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Write the plots of all rows, the results of `bins.solve`."""
    scales = sorted({row["scale"] for row in rows})
    lines = math.ceil(len(scales) / COLUMNS)
    figure = Figure(
        figsize=(11, 3.0 * lines + 1.0), dpi=110, layout="constrained", facecolor="white"
    )
    axes = figure.subplots(lines, COLUMNS, squeeze=False, sharex=True, sharey=True)
    for axis, scale in zip(axes.flat, scales, strict=False):
        draw_scale(axis, [row for row in rows if row["scale"] == scale])
        axis.set_title(f"{scale} sensor pixels a photo pixel", size=9, color=INK, loc="left")
    for axis in axes.flat[len(scales) :]:
        axis.set_axis_off()
    for axis in axes[:, 0]:
        axis.set_ylabel("RMS error of the photo,\ncodes of 255", size=9, color=INK)
    for axis in axes.flat[max(0, len(scales) - COLUMNS) : len(scales)]:
        axis.set_xlabel("time of one photo, ms", size=9, color=INK)
        axis.tick_params(labelbottom=True)
    legend(figure, rows)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, pil_kwargs={"optimize": True})


def draw_scale(axis: Axes, rows: Sequence[dict[str, Any]]) -> None:
    """Draw medians and quartiles over the problems of one number of sensor pixels a photo pixel, by
    tolerance, and the median strength of the moiré."""
    for reading, (colour, marker) in STYLE.items():
        middles = []
        for tolerance, size in zip(tolerances(rows), SIZES, strict=True):
            own = [row for row in rows if row["tolerance"] == tolerance]
            times = quartiles([row[f"{reading}_ms"] for row in own])
            errors = quartiles([max(MIN_DRAWN_ERROR, row[f"{reading}_error"]) for row in own])
            axis.errorbar(
                times[1],
                errors[1],
                xerr=[[times[1] - times[0]], [times[2] - times[1]]],
                yerr=[[errors[1] - errors[0]], [errors[2] - errors[1]]],
                color=colour,
                marker=marker,
                markersize=size,
                elinewidth=1.0,
            )
            middles.append((times[1], errors[1]))
        axis.plot(*zip(*middles, strict=True), color=colour, linewidth=0.8)
    axis.axhline(np.median([row["moire"] for row in rows]), **MOIRE_LINE)
    axis.set(xscale="log", yscale="log", ylim=(MIN_DRAWN_ERROR / 1.6, 20))
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    finish_log_axes(axis)


def tolerances(rows: Sequence[dict[str, Any]]) -> list[float]:
    return sorted({row["tolerance"] for row in rows})


def quartiles(values: Sequence[float]) -> list[float]:
    return np.percentile(values, [25, 50, 75]).tolist()


def legend(figure: Figure, rows: Sequence[dict[str, Any]]) -> None:
    dial = ", ".join(f"1/{1 / tolerance:.0f}" for tolerance in tolerances(rows))
    handles = []
    for reading, (colour, marker) in STYLE.items():
        label = f"{reading}, tolerance {dial} from large to small"
        handles.append(Line2D([], [], color=colour, marker=marker, linewidth=0.8, label=label))
    handles.append(Line2D([], [], **MOIRE_LINE, label="the moiré itself"))
    title = (
        "Medians over pitches, views and layouts; bars span the quartiles. Errors are against a "
        f"full reading of tolerance 1/8192; those below {MIN_DRAWN_ERROR:g} are drawn there"
    )
    legend_above(figure, handles, title)
