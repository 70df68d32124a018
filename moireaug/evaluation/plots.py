"""The report's plots, as SVG text. Each is drawn wide for a page and narrow for a phone.

The colours are Okabe and Ito's (2008), told apart by every common kind of colour vision; in print the markers' shapes
say the same.
"""

from __future__ import annotations

import io
from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from moireaug.evaluation.grids import CONTROLS
from moireaug.evaluation.table import Table
from moireaug.evaluation.words import Metrics, finite, interval, is_attack, points, title_of

OURS, THEIRS = "#0072B2", "#D55E00"  # this model, the baseline
INK, FAINT = "#222222", "#DDDDDD"


def ladder(
    rows: Sequence[Metrics],
    baseline: Sequence[Metrics],
    names: tuple[str, str],
    gains: dict[str, tuple[float | None, tuple[float, float] | None]],
    narrow: bool = False,
) -> str:
    """Accuracy with its 95 % interval per rung, this model's under the baseline's, and the gain at the right.

    Args:
        rows, baseline: `Row.to_dict()` of each model; the baseline's may be empty. Rungs are matched by name.
        names: of this model and of the baseline, for the legend.
        gains: row name to (gain, its interval).
    """
    pitch = (0.56 if narrow else 0.37) if baseline else (0.46 if narrow else 0.29)
    fig = Figure(figsize=(4.1 if narrow else 9.2, pitch * len(rows) + 0.95), layout="constrained", facecolor="white")
    ax = fig.add_subplot(facecolor="white")
    lift, down = (0.14 if baseline else 0.0), (0.13 if narrow else 0.0)  # a narrow plot has each title above its dots
    sides = [(baseline, -lift, "D", THEIRS, f"baseline ({names[1]})")] if baseline else []
    sides += [(rows, lift, "o", OURS, f"this model ({names[0]})")]
    place = {row["name"]: i + down for i, row in enumerate(rows)}
    for side, shift, marker, colour, label in sides:
        ax.plot([], [], marker=marker, color=colour, linewidth=2, markersize=5, label=label)
        for row in side:
            value, ends = finite(row.get("accuracy")), interval(row.get("accuracy_interval"))
            if row["name"] not in place or value is None:
                continue
            y = place[row["name"]] + shift
            if ends:
                ax.plot([100 * e for e in ends], [y, y], color=colour, linewidth=2, alpha=0.65, solid_capstyle="butt")
            ax.plot([100 * value], [y], marker, color=colour, markersize=6 if marker == "o" else 5, clip_on=False)
    for i, row in enumerate(rows):
        if narrow:
            ax.text(0, i - 0.27, title_of(row), size=8.5, color=INK, va="center", parse_math=False)
        else:
            ax.axhline(i, color=FAINT, linewidth=0.7, zorder=0)
        if i and is_attack(row) and not is_attack(rows[i - 1]):
            ax.axhline(i - 0.5, color=INK, linewidth=0.6, linestyle=(0, (4, 3)))
    beside = {"transform": ax.get_yaxis_transform(), "size": 8.5, "color": INK, "va": "center"}
    for name, (gain, ends) in gains.items():
        text = points(gain) + (f"  [{points(ends[0])}, {points(ends[1])}]" if ends and not narrow else "")
        ax.text(1.03, place[name], text, **beside)
    if gains:
        ax.text(1.03, -0.65, "gain" if narrow else "gain, points  [95 %]", **beside)
    ax.set(xlim=(0, 100), ylim=(len(rows) - 0.45, -0.55), xticks=range(0, 101, 20))
    titles = [] if narrow else [title_of(row) for row in rows]
    ax.set_yticks(range(len(titles)), titles, parse_math=False)
    counts = {row.get("n") for row in rows}
    _finish(ax, f"accuracy, % of {counts.pop()} images" if len(counts) == 1 else "accuracy, % of images", "x")
    _legend(fig, ax, narrow)
    return _svg(fig)


def curves(trains: Sequence[Metrics | None], names: tuple[str, str], narrow: bool = False) -> str | None:
    """Loss and validation accuracy per epoch; None where no model has a history.

    Args:
        trains: `train` of this model and of the baseline.
        names: of the two.
    """
    shape = (2, 1) if narrow else (1, 2)
    fig = Figure(figsize=(4.1, 5.6) if narrow else (9.2, 3.4), layout="constrained", facecolor="white")
    losses, rates = fig.subplots(*shape)
    roles = [(f"baseline ({names[1]})", trains[1], THEIRS, "D"), (f"this model ({names[0]})", trains[0], OURS, "o")]
    lines = {"clean": ("-", "clean images"), "perturbed": ((0, (3, 1.5)), "under its own adversary")}
    last = 1
    for label, train, colour, marker in roles:
        look = {"color": colour, "marker": marker, "markersize": 3.2}
        losses.plot(*_series(train, "loss"), **look)
        for key, (dash, what) in lines.items():
            epochs, values = _series(train, key)
            if not epochs:
                continue
            rates.plot(epochs, [100 * v for v in values], linestyle=dash, label=f"{label}: {what}", **look)
            kept = finite((train or {}).get("best_epoch"))
            if kept is not None and kept + 1 in epochs:
                best = values[epochs.index(int(kept) + 1)]
                ring = {"color": colour, "markersize": 10, "fillstyle": "none", "clip_on": False}
                rates.plot([kept + 1], [100 * best], "o", **ring)
            last = max(last, *epochs)
    if not any(len(line.get_xdata()) for line in (*losses.lines, *rates.lines)):
        return None
    for ax, label in ((losses, "training loss, nats"), (rates, "validation accuracy, %")):
        ax.set_ylim((0, 100) if ax is rates else (0, None))
        ax.set_xlim(1 - 0.04 * last, 1.04 * last)
        ax.xaxis.get_major_locator().set_params(integer=True, nbins=7)
        ax.set_ylabel(label, size=9, color=INK)
        _finish(ax, "epoch", "y")
    _legend(fig, rates, narrow)
    return _svg(fig)


def facets(table: Table, rows: Sequence[Metrics], narrow: bool = False) -> str:
    """Success by row, one panel a column of the table; controls in grey, the paper's figures as hollow diamonds."""
    down = -(-len(table.columns) // (3 if narrow else 8))
    across, high, step = -(-len(table.columns) // down), len(table.rows) + 2.6, 100 + (30 if narrow else 18)
    size = (4.1, 0.19 * high * down + 0.3) if narrow else (9.2, 0.21 * high * down + 0.3)
    fig = Figure(figsize=size, layout="constrained", facecolor="white")
    ax = fig.add_subplot(facecolor="white")  # all panels in one, which draws ten times as fast as one each
    known = {(r["row"], r["column"]): r for r in rows if r["success"] is not None}
    text = {"size": 7 if narrow else 8.5, "color": INK, "ha": "center", "va": "center", "parse_math": False}
    for k, column in enumerate(table.columns):
        left, top = step * (k % across), high * (k // across)
        bottom = top + len(table.rows) - 0.5
        colour = "#777777" if column in CONTROLS else OURS
        cells = [(top + i, known[row, column]) for i, row in enumerate(table.rows) if (row, column) in known]
        ys, papers = [y for y, _ in cells], [(y, r["paper"]) for y, r in cells if r["paper"] is not None]
        ax.vlines([left, left + 50, left + 100], top - 0.5, bottom, color=FAINT, linewidth=0.7, zorder=0)
        for edge in ("low", "high"):
            ax.hlines(ys, *([left + 100 * r[x] for _, r in cells] for x in ("success", edge)), color=colour, alpha=0.6)
        ax.plot([left + 100 * r["success"] for _, r in cells], ys, "o", color=colour, markersize=4.5)
        hollow = {"color": THEIRS, "markerfacecolor": "none", "markersize": 6}
        ax.plot([left + 100 * paper for _, paper in papers], [y for y, _ in papers], "D", **hollow)
        ax.text(left + 50, top - 1.0, column, **text)
        for tick, side in ((0, "left"), (50, "center"), (100, "right")):
            ax.text(left + tick, bottom + 0.55, str(tick), **text | {"size": text["size"] - 1, "ha": side})
    places = [(high * d + i, row) for d in range(down) for i, row in enumerate(table.rows)]
    ax.set_yticks([y for y, _ in places], [row for _, row in places], parse_math=False)
    ax.set(xlim=(-6, step * across - 8), ylim=(high * down - 1.6, -1.6), xticks=())
    ax.tick_params(labelsize=text["size"], labelcolor=INK, length=0)
    ax.spines[:].set_visible(False)
    ax.set_xlabel("images fooled, %", size=9, color=INK)
    return _svg(fig)


def _series(train: Metrics | None, key: str) -> tuple[list[int], list[float]]:
    """Epochs, counted from 1, and the values that are known."""
    history = enumerate((train or {}).get("history") or [])
    pairs = [
        (int(finite(row.get("epoch", i)) or 0) + 1, v) for i, row in history if (v := finite(row.get(key))) is not None
    ]
    return [epoch for epoch, _ in pairs], [value for _, value in pairs]


def _finish(ax: Axes, label: str, grid: str) -> None:
    ax.set_xlabel(label, size=9, color=INK)
    ax.tick_params(labelsize=9, labelcolor=INK, color=FAINT, length=0 if grid == "x" else 3)
    ax.grid(axis=grid, color=FAINT, linewidth=0.7)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"] + (["left"] if grid == "x" else [])].set_visible(False)
    ax.spines[:].set_color("#999999")


def _legend(fig: Figure, ax: Axes, narrow: bool) -> None:
    handles, _ = ax.get_legend_handles_labels()
    if not handles:
        return
    legend = fig.legend(
        handles=handles, loc="outside upper left", ncols=1 if narrow else 2, frameon=False, fontsize=9, labelcolor=INK
    )
    for text in legend.get_texts():
        text.set_parse_math(False)  # a recipe may have a dollar sign in its name


def _svg(fig: Figure) -> str:
    """The figure as SVG, its letters as outlines, so that it looks the same where a font is missing."""
    file = io.StringIO()
    fig.savefig(file, format="svg", metadata={"Date": None})
    return file.getvalue()
