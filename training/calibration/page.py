"""The report of a calibration: a page, and a plot of medians and spans."""

import math
from collections.abc import Sequence
from typing import Any

import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from moireaug.scenes import Scene
from training.calibration.compare import (
    Crops,
    Span,
    StatisticRow,
    mean_distance,
    number_text,
    span_text,
)
from training.calibration.fit import FittedScene
from training.report.page import middle_of, picture_cells, render, uri
from training.report.plots import BASELINE_COLOUR, GRID_COLOUR, MODEL_COLOUR, TEXT_COLOUR, png
from training.system import machine

MAX_CROPS = 6  # of the page
SIZE_INCHES, DPI = (10.4, 6.4), 100
MAIN_UNIT = "codes RMS"  # of most statistics, on the left
MARK_SHIFT = 0.17  # of the two marks of a row, in rows
MIN_CODES = 0.05  # on the logarithmic axis
REAL, SIMULATED = (MODEL_COLOUR, "o"), (BASELINE_COLOUR, "D")  # colour and marker


def example_blocks(crops: Crops, simulated: torch.Tensor | None, name: str) -> list[dict[str, Any]]:
    """Return the pictures of the page: a crop of each of the first pictures, side by side."""
    examples = []
    for index, label in list(enumerate(crops.names))[:MAX_CROPS]:
        row = int((crops.picture == index).nonzero()[0])
        pictures = {"real photo": crops.photos, name: simulated, "original": crops.originals}
        sides = {k: None if p is None else middle_of(p[row]) for k, p in pictures.items()}
        examples.append({"label": label, "cells": picture_cells(sides)})
    return examples


def page(
    table: Sequence[StatisticRow],
    crops: Crops,
    scene: Scene,
    name: str,
    plot: bytes,
    examples: list[dict[str, Any]],
    fitted: FittedScene | None,
) -> str:
    """Return the report as a self-contained page."""
    paired = crops.originals is not None
    run: dict[str, Any] = dict.fromkeys(("environment", "config", "scene"))
    run |= {"command": machine.command(), "scene_name": name}
    run["plan"] = str(scene.plan()) if paired else None
    return render(
        "calibration.html.j2",
        facts={"photos": len(crops.names), "crops": len(crops.photos)},
        side=crops.photos.shape[-1],
        plot=uri(plot, "image/png"),
        table=table,
        span_text=span_text,
        number_text=number_text,
        distance=mean_distance(table) if paired else None,
        scene=name,
        paired=paired,
        fitted=fitted,
        examples=examples,
        metrics=run,
    )


def draw(lines: Sequence[StatisticRow], name: str) -> bytes:
    """Return the plot as a PNG: one panel per unit, one row per statistic."""
    groups: dict[str, list[StatisticRow]] = {}
    for line in lines:
        if line.statistic.compared:
            groups.setdefault(line.statistic.unit, []).append(line)
    main_group, other_groups = groups.pop(MAIN_UNIT), list(groups.values())
    fig = Figure(figsize=SIZE_INCHES, dpi=DPI, layout="constrained", facecolor="white")
    outer = fig.add_gridspec(1, 2)
    _panel(fig.add_subplot(outer[0]), main_group, name)
    heights = [len(group) + 0.9 for group in other_groups]
    inner = outer[1].subgridspec(len(other_groups), 1, height_ratios=heights)
    for i, group in enumerate(other_groups):
        _panel(fig.add_subplot(inner[i]), group, name)
    handles, labels = fig.axes[0].get_legend_handles_labels()
    fig.legend(handles, labels, loc="outside upper center", ncols=2, frameon=False, fontsize=10)
    return png(fig)


def _panel(ax: Axes, group: Sequence[StatisticRow], name: str) -> None:
    least = -math.inf
    if group[0].statistic.unit == MAIN_UNIT:
        ax.set_xscale("log")
        ax.xaxis.set_major_formatter("{x:g}")
        least = MIN_CODES
    for row, line in enumerate(group):
        # a legend needs each name once
        real_name, simulated_name = ("real photos", name) if row == 0 else (None, None)
        shift = MARK_SHIFT if line.simulated else 0
        _mark(ax, line.real, row - shift, least, REAL, real_name)
        if line.simulated:
            _mark(ax, line.simulated, row + shift, least, SIMULATED, simulated_name)
    ax.set_yticks(range(len(group)), [line.statistic.title for line in group], size=9.5)
    ax.set_ylim(len(group) - 0.5, -0.5)
    ax.set_xlabel(group[0].statistic.unit or "share", size=9.5, color=TEXT_COLOUR, labelpad=1)
    ax.tick_params(labelsize=9, labelcolor=TEXT_COLOUR, color=GRID_COLOUR)
    ax.grid(axis="x", color=GRID_COLOUR, linewidth=0.7)
    ax.set_axisbelow(True)
    ax.spines[["top", "right", "left"]].set_visible(False)
    ax.spines["bottom"].set_color("#999999")


def _mark(
    ax: Axes, values: Span, y: float, least: float, style: tuple[str, str], label: str | None
) -> None:
    """Draw a span as a bar and its median as a marker; smaller values are drawn at `least`."""
    colour, marker = style
    low, median, high = (max(least, value) for value in values)
    ax.plot([low, high], [y, y], color=colour, linewidth=2, alpha=0.55, solid_capstyle="butt")
    ax.plot([median], [y], marker, color=colour, markersize=5.5, label=label)
