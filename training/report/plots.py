"""The plots of a report, as SVG text. Rates are drawn by the page itself, in its tables.

The colours are Okabe and Ito's (2008), told apart by every common kind of colour vision; in print
the markers' shapes say the same. The background is transparent: in dark mode the page inverts the
lightness of a plot and keeps its hues.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from training.report.numbers import finite

MODEL_COLOUR, BASELINE_COLOUR = "#0072B2", "#D55E00"  # this model, the baseline
TEXT_COLOUR, GRID_COLOUR = "#222222", "#DDDDDD"
FIGURE_INCHES = (4.6, 3.3)  # readable on a phone, and two abreast on a page
SOLID_LINE, DASHED_LINE = "-", (0, (3, 1.5))
Training = Mapping[str, Any]


def curves(trains: Mapping[str, Training | None]) -> list[str]:
    """Draw loss and validation accuracy per epoch, one plot each; none where no model has a
    history.

    Args:
        trains: name to `train` of this model, and of the baseline after it.
    """
    styles = [(MODEL_COLOUR, "o"), (BASELINE_COLOUR, "D")]
    loss = Figure(FIGURE_INCHES, layout="constrained")
    rate = Figure(FIGURE_INCHES, layout="constrained")
    losses, rates = loss.subplots(), rate.subplots()
    last = 0
    for (name, train), (colour, marker) in zip(trains.items(), styles, strict=False):
        style: dict[str, Any] = {"color": colour, "marker": marker, "markersize": 3.2}
        epochs, values = _series(train, "loss")
        losses.plot(epochs, values, label=name, **style)
        last = max(last, *epochs, 0)
        lines = (("clean", SOLID_LINE, "clean"), ("perturbed", DASHED_LINE, "attacked"))
        for key, line, kind in lines:
            epochs, values = _series(train, key)
            if epochs:
                heights = [100 * value for value in values]
                rates.plot(epochs, heights, linestyle=line, label=f"{name}: {kind}", **style)
                _ring_best_epoch(rates, train, epochs, heights, colour)
                last = max(last, *epochs)
    if not last:
        return []
    losses.set_ylim(0, None)
    rates.set_ylim(0, 100)
    for ax, label in ((losses, "training loss, nats"), (rates, "validation accuracy, %")):
        ax.set_xlim(1 - 0.04 * last, 1.04 * last)
        finish(ax, "epoch", label)
        legend = ax.legend(frameon=False, fontsize=9, labelcolor=TEXT_COLOUR)
        for text in legend.get_texts():
            text.set_parse_math(False)  # a recipe may have a dollar sign in its name
    return [svg(loss), svg(rate)]


def _series(train: Training | None, key: str) -> tuple[list[int], list[float]]:
    """Return the epochs, counted from 1, with known values, and those values."""
    epochs, values = [], []
    for i, row in enumerate((train or {}).get("history") or []):
        value = finite(row.get(key))
        if value is not None:
            epochs.append(int(finite(row.get("epoch", i)) or 0) + 1)
            values.append(value)
    return epochs, values


def _ring_best_epoch(
    ax: Axes, train: Training | None, epochs: Sequence[int], heights: Sequence[float], colour: str
) -> None:
    """Mark the epoch whose weights were saved."""
    best_epoch = finite((train or {}).get("best_epoch"))
    if best_epoch is not None and best_epoch + 1 in epochs:
        height = heights[epochs.index(int(best_epoch) + 1)]
        ring: dict[str, Any] = {"markersize": 10, "fillstyle": "none", "clip_on": False}
        ax.plot([best_epoch + 1], [height], "o", color=colour, **ring)


def finish(ax: Axes, x: str, y: str) -> None:
    """Label the axes, of which x counts something, and draw them faintly."""
    ax.xaxis.set_major_locator(MaxNLocator(7, integer=True))
    ax.set_xlabel(x, size=10, color=TEXT_COLOUR)
    ax.set_ylabel(y, size=10, color=TEXT_COLOUR)
    ax.tick_params(labelsize=9.5, labelcolor=TEXT_COLOUR, color=GRID_COLOUR)
    ax.grid(axis="y", color=GRID_COLOUR, linewidth=0.7)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[:].set_color("#999999")


def svg(figure: Figure) -> str:
    """Return the figure as SVG, its letters as outlines, so that it looks the same where a font is
    missing."""
    file = io.StringIO()
    figure.savefig(file, format="svg", metadata={"Date": None}, transparent=True)
    return file.getvalue()
