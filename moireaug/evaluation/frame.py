"""One pandas frame of an evaluation: a row for each cell of its tables and each image. Everything
else is a pivot."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from moireaug.attacks import REJECTED, UNDECIDED
from moireaug.evaluation.classifiers import Classifier
from moireaug.evaluation.conditions import CELL_COLUMNS, CONDITION_COLUMNS, Condition
from moireaug.evaluation.runner import CLEAN, Runner
from moireaug.evaluation.statistics import wilson
from moireaug.evaluation.tables import Table
from moireaug.synthesis.twins import SEEN_CODES

MEASURES = ("psnr", "ssim", "ciede2000", "largest", "lpips")
MOIRE_MEASURES = ("moire", "moire_seen")  # of photos without noise: see `rates`
# without which rates are printed as a plain frame
PRINTED_COLUMNS = {*CELL_COLUMNS, "eps", "largest", "psnr", "moire", "accuracy", "success", "n"}


def images_frame(tables: Sequence[Table], runner: Runner, indices: Sequence[int]) -> pd.DataFrame:
    """Return a row for each cell and image.

    Columns: `table`, `row`, `column`; `condition`, `control`, `eps`, `bound`, the scale of eps
    ("codes", "light" or, without noise, ""), `steps`, `targeted`; `judge`, the name of the
    classifier; `image`, its number; `label`, `target`, `predicted`; `correct`; `fooled`, whether
    the attack's goal is reached; `counted`, whether the model without a defence gets the clean
    image right; `rejected`, whether a model that can do so rejects the image, which is then neither
    correct nor fooled; `undecided`, whether the logits were not finite; `seconds`, the image's
    share of the batch's, of which an attack that several classifiers see counts in full for each,
    so that their sum may exceed the time taken; and measures such as `psnr`, of attacks, and
    `moire`, of photos: their RMS difference from the same photo without moiré, of 255.
    """
    condition_frames: dict[tuple[str, str], pd.DataFrame] = {}
    cell_frames: dict[tuple[str, str, str], pd.DataFrame] = {}
    for table in tables:
        for cell in table.cells:
            frames = []
            for condition in cell.conditions:
                key = (condition.name, cell.classifier.name)
                if key not in condition_frames:
                    frame = _condition_frame(condition, cell.classifier, runner, indices)
                    condition_frames[key] = frame
                frames.append(condition_frames[key])
            cell_frame = _worst(frames) if cell.worst else pd.concat(frames)
            cell_frames[table.name, *cell.place] = cell_frame
    if not cell_frames:
        return pd.DataFrame(columns=[*CELL_COLUMNS, *CONDITION_COLUMNS, "image", "correct"])
    frame = pd.concat(cell_frames, names=CELL_COLUMNS)
    return frame.reset_index(CELL_COLUMNS).reset_index(drop=True)


def _condition_frame(
    condition: Condition, classifier: Classifier, runner: Runner, indices: Sequence[int]
) -> pd.DataFrame:
    """Return one condition before one classifier, a row per image."""
    batch_frames = []
    start = 0
    for index in indices:
        record = runner.record(condition, classifier, index)
        clean = runner.record(CLEAN, classifier.base, index)
        n = len(record["labels"])
        columns = {
            "label": record["labels"],
            "target": record["targets"],
            "predicted": record["predicted"],
            "counted": np.equal(clean["predicted"], clean["labels"]),
            "image": range(start, start + n),
            "seconds": record["seconds"] / n,
        }
        batch_frames.append(pd.DataFrame(columns | record["measured"]))
        start += n
    frame = pd.concat(batch_frames, ignore_index=True)
    frame["correct"] = frame["predicted"] == frame["label"]
    reaches_target = frame["predicted"] == frame["target"]
    frame["rejected"] = frame["predicted"] == REJECTED
    is_wrong = ~frame["correct"] & ~frame["rejected"]
    frame["fooled"] = reaches_target if condition.targeted else is_wrong
    frame["undecided"] = frame["predicted"] == UNDECIDED
    return frame.assign(
        condition=condition.name,
        control=condition.control,
        eps=condition.eps,
        bound=condition.eps_unit(runner.setup.bound),
        steps=getattr(condition, "steps", 0),
        targeted=condition.targeted,
        judge=classifier.name,
    )


def _worst(frames: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """Return the worst of several conditions for each image."""
    worst = frames[0][["label", "counted", "image"]].copy()
    worst["correct"] = np.all([frame["correct"] for frame in frames], axis=0)
    # also by an attacker who aimed at another class
    is_wrong = [~frame["correct"] & ~frame["rejected"] for frame in frames]
    worst["fooled"] = np.any(is_wrong, axis=0)
    worst["rejected"] = ~worst["correct"] & ~worst["fooled"]
    worst["undecided"] = np.any([frame["undecided"] for frame in frames], axis=0)
    worst["seconds"] = np.sum([frame["seconds"] for frame in frames], axis=0)
    # those of the strongest attack
    eps, steps, bound = max(tuple(frame[["eps", "steps", "bound"]].iloc[0]) for frame in frames)
    return worst.assign(
        condition="worst",
        control=False,
        eps=eps,
        bound=bound,
        steps=steps,
        targeted=False,
        judge=frames[0]["judge"].iloc[0],
    )


class RatesFrame(pd.DataFrame):
    """A frame of rates that prints as a table of percentages; any part of it is a plain frame."""

    @property
    def _constructor(self) -> type[pd.DataFrame]:
        return pd.DataFrame

    def _repr_html_(self) -> None:
        """Leave it to `repr` in notebooks, too."""

    def __repr__(self) -> str:
        if not {*self.columns} >= PRINTED_COLUMNS:
            return super().__repr__()
        texts = []
        for name, part in self.groupby("table", sort=False):
            head = f"{name}, accuracy and success in % [95 %], eps in 1/255"
            if part["moire"].notna().any():
                head += ", moiré (median) in codes RMS"
            texts.append(f"{head}\n{_text(part)}")
        return "\n\n".join(texts)


def _text(cells: pd.DataFrame) -> str:
    """Return the rates of one table as text: a line per cell."""
    lines = {
        "": cells["row"],
        "column": cells["column"],
        "eps": (255 * cells["eps"]).map("{:g}".format),
        "codes": (255 * cells["largest"]).map("{:.3g}".format),
        "dB": cells["psnr"].map("{:.1f}".format),
        "moiré": cells["moire"].map("{:.2g}".format),
        "accuracy": _percent_text(cells, "accuracy", "accuracy_low", "accuracy_high"),
        "success": _percent_text(cells, "success", "low", "high"),
        "n": cells["n"],
    }
    if cells["moire"].isna().all():
        del lines["moiré"]
    return pd.DataFrame(lines).replace("nan", "").to_string(index=False)


def _percent_text(cells: pd.DataFrame, rate: str, low: str, high: str) -> list[str]:
    """Return the text of a rate and its interval for each cell."""
    return [
        "" if np.isnan(p) else f"{100 * p:.1f} [{100 * a:.1f}, {100 * b:.1f}]"
        for p, a, b in zip(cells[rate], cells[low], cells[high], strict=True)
    ]


def rates(frame: pd.DataFrame) -> RatesFrame:
    """Return a row per cell: rates with their 95 % intervals, denominators, mean measures, seconds.
    Printed, it is a table of the attacks, their visibility and their rates.

    Columns: those of `images_frame` up to `judge`; `accuracy`, `accuracy_low`, `accuracy_high` of
    all images; `success`, `low`, `high` of the `counted` ones, where `success` is NaN if there are
    none; `n`, `counted`, `rejected`, `undecided`, `seconds`; the measures, over images that got
    noise; `moire`, the median of moiré in photos, in codes RMS, and `moire_seen`, the share of
    photos with more than `SEEN_CODES`; `outcomes`, a 0 or 1 per image, for paired comparisons; and
    `paper`, empty, for published figures.

    Raises:
        ValueError: a frame of several evaluations, joined.
    """
    _refuse_joined(frame)
    lines = [_rates(cell) for _, cell in frame.groupby(CELL_COLUMNS, sort=False)]
    columns = [*CELL_COLUMNS, *CONDITION_COLUMNS, "accuracy", "accuracy_low", "accuracy_high"]
    columns += ["success", "low", "high", "n", "counted", "rejected"]
    columns += ["undecided", "seconds", *MEASURES, *MOIRE_MEASURES, "outcomes", "paper"]
    return RatesFrame(pd.DataFrame(lines).reindex(columns=columns))


def _refuse_joined(frame: pd.DataFrame) -> None:
    """Refuse a frame in which an image stands twice in a cell under one condition: ValueError."""
    repeated = frame[frame.duplicated([*CELL_COLUMNS, "condition", "image"])]
    if len(repeated):
        first = repeated.iloc[0]
        raise ValueError(
            f"the frame has image {first['image']} twice in the row {first['row']!r} of the table "
            f"{first['table']!r}: it seems to join several evaluations, which would be pooled. "
            "Join their rates instead: pd.concat([rates(a).assign(model='a'), "
            "rates(b).assign(model='b')])."
        )


def _rates(cell: pd.DataFrame) -> dict[str, object]:
    """Return the rates of a cell, and its means of measures over the images that got noise: an
    image that is fooled without noise has nothing to measure, and its PSNR means nothing."""
    n, conditions = len(cell), cell["condition"].nunique()
    line: dict[str, object] = {}
    for name in (*CELL_COLUMNS, *CONDITION_COLUMNS):
        line[name] = cell[name].iloc[0]
    if conditions > 1:
        line["condition"] = f"{conditions} pooled"
    clean_correct = int(cell["counted"].sum())
    hits = int((cell["fooled"] & cell["counted"]).sum())
    correct = int(cell["correct"].sum())
    # photos of one image are not independent trials: the interval is that of as many images
    photos = n / max(1, cell["image"].nunique())
    low, high = wilson(hits / photos, clean_correct / photos)
    accuracy_low, accuracy_high = wilson(correct / photos, n / photos)
    line |= {
        "accuracy": correct / n,
        "accuracy_low": accuracy_low,
        "accuracy_high": accuracy_high,
        "success": hits / clean_correct if clean_correct else np.nan,
        "low": low,
        "high": high,
        "n": n,
        "counted": clean_correct,
        "rejected": int(cell["rejected"].sum()),
        "undecided": int(cell["undecided"].sum()),
        "seconds": float(cell["seconds"].sum()),
        "outcomes": "".join("1" if right else "0" for right in cell["correct"]),
    }
    if "moire" in cell and (moire := cell["moire"].dropna()).size:
        line |= {"moire": float(moire.median()), "moire_seen": float((moire > SEEN_CODES).mean())}
    if "largest" in cell:
        cell = cell[cell["largest"] > 0]
    for name in MEASURES:
        if name in cell and cell[name].notna().any():
            line[name] = float(cell[name].mean())
    return line
