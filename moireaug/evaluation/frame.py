"""One pandas frame of an evaluation: a row for each cell of its tables and each image. Everything
else is a pivot."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import resources

import numpy as np
import pandas as pd

from moireaug.attacks import UNDECIDED
from moireaug.evaluation.conditions import Condition
from moireaug.evaluation.judges import UNDEFENDED, Judge
from moireaug.evaluation.runner import CLEAN, Runner
from moireaug.evaluation.statistics import wilson
from moireaug.evaluation.tables import Table

CELL = ["table", "row", "column"]
MEASURES = ("psnr", "ssim", "ciede2000", "largest", "lpips")
ABOUT = ("condition", "control", "eps", "steps", "targeted", "judge")


def images_frame(tables: Sequence[Table], runner: Runner, indices: Sequence[int]) -> pd.DataFrame:
    """Return a row for each cell and image.

    Columns: `table`, `row`, `column`; `condition`, `control`, `eps`, `steps`, `targeted`, `judge`;
    `image`, its number; `label`, `target`, `predicted`; `correct`; `fooled`, whether the attack's
    goal is reached; `counted`, whether the judge without its defence gets the clean image right;
    `undecided`, whether the logits were not finite; `seconds`, the image's share; and what was
    measured, such as `psnr`.
    """
    seen: dict[tuple[str, str], pd.DataFrame] = {}
    parts = []
    for table in tables:
        for cell in table.cells:
            shown = []
            for condition in cell.conditions:
                key = (condition.name, cell.judge.name)
                if key not in seen:
                    seen[key] = _condition_frame(condition, cell.judge, runner, indices)
                shown.append(seen[key])
            part = _worst(shown) if cell.worst else pd.concat(shown, ignore_index=True)
            parts.append(part.assign(table=table.name, row=cell.row, column=cell.column))
    if not parts:
        return pd.DataFrame(columns=[*CELL, *ABOUT, "image", "correct"])
    frame = pd.concat(parts, ignore_index=True)
    others = [name for name in frame.columns if name not in CELL]
    return frame[[*CELL, *others]]


def _condition_frame(
    condition: Condition, judge: Judge, runner: Runner, indices: Sequence[int]
) -> pd.DataFrame:
    """Return one condition before one judge, a row per image."""
    base = UNDEFENDED
    if judge.base != UNDEFENDED.name:
        base = Judge(judge.base, model=judge.model)
    parts = []
    start = 0
    for index in indices:
        record = runner.record(condition, judge, index)
        clean = runner.record(CLEAN, base, index)
        n = len(record["labels"])
        part = pd.DataFrame({name: record[f"{name}s"] for name in ("label", "target")})
        part["predicted"] = record["predicted"]
        part["counted"] = np.equal(clean["predicted"], clean["labels"])
        part["image"] = range(start, start + n)
        part["seconds"] = record["seconds"] / n
        for name, values in record["measured"].items():
            part[name] = values
        parts.append(part)
        start += n
    frame = pd.concat(parts, ignore_index=True)
    frame["correct"] = frame["predicted"] == frame["label"]
    reached = frame["predicted"] == frame["target"]
    frame["fooled"] = reached if condition.targeted else ~frame["correct"]
    frame["undecided"] = frame["predicted"] == UNDECIDED
    about = {
        "condition": condition.name,
        "control": condition.control,
        "eps": condition.eps,
        "steps": getattr(condition, "steps", 0),
        "targeted": condition.targeted,
        "judge": judge.name,
    }
    return frame.assign(**about)


def _worst(shown: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """Return the worst of several conditions for each image."""
    worst = shown[0][["label", "counted", "image"]].copy()
    for name in ("fooled", "undecided"):
        worst[name] = np.any([one[name] for one in shown], axis=0)
    worst["correct"] = np.all([one["correct"] for one in shown], axis=0)
    worst["seconds"] = np.sum([one["seconds"] for one in shown], axis=0)
    return worst.assign(
        condition="worst",
        control=False,
        eps=max(one["eps"].iloc[0] for one in shown),
        steps=max(one["steps"].iloc[0] for one in shown),
        targeted=False,
        judge=shown[0]["judge"].iloc[0],
    )


def rates(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a row per cell: rates with their 95 % intervals, denominators, means of what was
    measured, seconds.

    Columns: those of `images_frame` up to `judge`; `accuracy`, `accuracy_low`, `accuracy_high` of
    all images; `success`, `low`, `high` of the `counted` ones, where `success` is NaN if there are
    none; `n`, `counted`, `undecided`, `seconds`; the measures, over images that got noise;
    `outcomes`, a 0 or 1 per image, for paired comparisons; and `paper`, what the paper prints.
    """
    lines = []
    for (table, row, column), cell in frame.groupby(CELL, sort=False):
        line = {"table": table, "row": row, "column": column}
        for name in ABOUT:
            line[name] = cell[name].iloc[0]
        conditions = cell["condition"].nunique()
        if conditions > 1:
            line["condition"] = f"{conditions} pooled"
        lines.append(line | _rates(cell))
    columns = [*CELL, *ABOUT, "accuracy", "accuracy_low", "accuracy_high", "success", "low", "high"]
    columns += ["n", "counted", "undecided", "seconds", *MEASURES, "outcomes", "paper"]
    return pd.DataFrame(lines).reindex(columns=columns)


def _rates(cell: pd.DataFrame) -> dict[str, object]:
    n = len(cell)
    counted = int(cell["counted"].sum())
    hits = int((cell["fooled"] & cell["counted"]).sum())
    correct = int(cell["correct"].sum())
    # photos of one image are not independent trials: the interval is that of as many images
    photos = n / max(1, cell["image"].nunique())
    low, high = wilson(hits / photos, counted / photos)
    accuracy_low, accuracy_high = wilson(correct / photos, n / photos)
    found: dict[str, object] = {
        "accuracy": correct / n,
        "accuracy_low": accuracy_low,
        "accuracy_high": accuracy_high,
        "success": hits / counted if counted else np.nan,
        "low": low,
        "high": high,
        "n": n,
        "counted": counted,
        "undecided": int(cell["undecided"].sum()),
        "seconds": float(cell["seconds"].sum()),
        "outcomes": "".join("1" if right else "0" for right in cell["correct"]),
    }
    return found | _measures(cell)


def _measures(cell: pd.DataFrame) -> dict[str, float]:
    """Return the means over the images that got noise; none where no image did. An image that is
    fooled without noise has nothing to measure, and its PSNR means nothing."""
    if "largest" in cell:
        cell = cell[cell["largest"] > 0]
    found = {}
    for name in MEASURES:
        if name in cell and cell[name].notna().any():
            found[name] = float(cell[name].mean())
    return found


def with_paper(lines: pd.DataFrame, tables: Sequence[Table]) -> pd.DataFrame:
    """Fill in what the paper prints, where a table's cells are at the paper's bound."""
    own = {table.name for table in tables if table.published}
    published = read_published()
    published = published[published["table"].isin(own)]
    return lines.drop(columns="paper").merge(published, "left", on=CELL)


def read_published() -> pd.DataFrame:
    """Return what the paper prints: success rates on Inception-V3, 5000 ImageNet images that it
    classifies correctly.

    The paper's table 3 calls C&W an L-infinity and MI-FGSM an L2 attack; its text says the reverse,
    which is right for both.
    """
    path = resources.files("moireaug.evaluation").joinpath("published.csv")
    with path.open(encoding="utf-8") as file:
        return pd.read_csv(file)


def cell_of(
    lines: pd.DataFrame, row: str, column: str, table: str | None = None
) -> pd.Series | None:
    """Return the line of that row and column, or None."""
    wanted = (lines["row"] == row) & (lines["column"] == column)
    if table is not None:
        wanted &= lines["table"] == table
    found = lines[wanted]
    return None if found.empty else found.iloc[0]
