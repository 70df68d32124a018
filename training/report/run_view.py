"""The view of a run: numbers from its metrics, computed once for the page and the terminal."""

from collections.abc import Mapping, Sequence
from typing import Any

from moireaug.evaluation.frame import MEASURES, MOIRE_MEASURES
from training.report.numbers import Rate, distinct, moire_text
from training.report.page import name_of, title_of
from training.report.plots import Series
from training.runs.metrics import ORIGINAL, PlainMetrics, RunMetrics

MIN_WHOLE_CHANGE = 0.05  # the smallest change of rates that is printed without decimals
Side = RunMetrics | PlainMetrics
Sides = Mapping[str, Side]  # "baseline" where there is one, and "ours"
Row = dict[str, Any]
# rows of the table of costs, fields of `TrainCost`, and the digits of their figures
COST_ROWS = (
    ("training time, s", "total_seconds", 1),
    ("epochs", "total_epochs", 0),
    ("images per second", "images_per_second", 0),
    ("passes per image and epoch", "passes", 2),
)


def run_view(metrics: RunMetrics) -> dict[str, Any]:
    """Return the values for the templates of a run that was attacked by the ladder."""
    baseline = metrics.baseline
    sides: Sides = {"baseline": baseline, "ours": metrics} if baseline else {"ours": metrics}
    rows = _rows(metrics, sides)
    keeps_answers = baseline is not None and baseline.recipe == ORIGINAL
    attack = next((row for row in rows if row["headline"]), rows[-1])
    main = attack
    if keeps_answers:
        main = next((row for row in rows if row["name"] == "moire"), attack)
    return {
        "name": name_of(metrics),
        "baseline": name_of(baseline) if baseline else None,
        "sides": [_side(kind, side) for kind, side in sides.items()],
        "keeps_answers": keeps_answers,
        "rows": rows,
        "main": main,
        "noise": [row for row in rows if row["psnr"] is not None],
        "has_lpips": any(row["lpips"] is not None for row in rows),
        "moire": moire_text(rows),
        "shares": _shares(rows, attack["name"], sides),
        "visibility": _visibility(sides),
        "unanswered": _unanswered(sides),
        "clean": metrics.clean_accuracy,
        "clean_theirs": baseline.clean_accuracy if baseline else None,
        **_change(main["gain"]),
        "train": metrics.train,
        "seconds_theirs": baseline.train.total_seconds if baseline and baseline.train else None,
        "is_elsewhere": baseline is not None and _is_elsewhere(metrics, baseline),
        "kept": metrics.config.get("train", {}).get("kept"),
        "cost": _cost(sides),
    }


def _side(kind: str, side: Side) -> dict[str, Any]:
    counted = distinct(row["counted"] for row in side.reattack or [])
    return {"kind": kind, "name": name_of(side), "counted": counted}


def _rows(metrics: RunMetrics, sides: Sides) -> list[Row]:
    """Return the rows of the ladder, with every side's rates and the gain over the baseline."""
    rows: list[Row] = []
    for number, line in enumerate(metrics.reattack or []):
        row = dict.fromkeys((*MEASURES, *MOIRE_MEASURES)) | {"headline": False} | line
        row["title"] = title_of(line["name"], "ladder")
        row["sides"] = {k: _rates((side.reattack or [])[number]) for k, side in sides.items()}
        row["gain"] = None
        if metrics.baseline:
            row["gain"] = Rate(metrics.gain[line["name"]], *metrics.gain_interval[line["name"]])
        row["first_attack"] = bool(rows) and rows[-1]["control"] and not line["control"]
        rows.append(row)
    return rows


def _rates(line: Row) -> dict[str, Rate]:
    """Return accuracy and success of a row of the ladder."""
    rates = {}
    for name in ("accuracy", "success"):
        rates[name] = Rate(line[name], *line[f"{name}_interval"])
    return rates


def _change(gain: Rate | None) -> dict[str, Any]:
    """Return the change over the baseline in a word, and the digits to print it with: "raises" or
    "lowers"; "unclear" where the interval cannot tell it from none; None without a baseline."""
    if gain is None or gain.value is None:
        return {"change": None, "digits": 1}
    change = "raises" if gain.low > 0 else "lowers"
    if gain.low <= 0 <= gain.high:
        change = "unclear"
    return {"change": change, "digits": 0 if abs(gain.value) >= MIN_WHOLE_CHANGE else 1}


def _is_elsewhere(metrics: RunMetrics, baseline: PlainMetrics) -> bool:
    """Return whether a baseline was trained on another machine, as far as that is known."""
    ours, theirs = metrics.environment, baseline.environment or {}
    names = ("device", "cpu", "threads")
    return any(ours[name] != theirs[name] for name in names if name in ours and name in theirs)


def _visibility(sides: Sides) -> list[Series]:
    """Return accuracy by PSNR under the untargeted Moiré Attack and under PGD, this model first."""
    series = []
    for number, side in enumerate(reversed(list(sides.values()))):
        for attack, title in (("ma_", "Moiré Attack"), ("pgd_", "PGD on pixels")):
            points = []
            for row in side.reattack or []:
                is_of_it = row["name"].startswith(attack) and not row["targeted"]
                if is_of_it and row.get("psnr") is not None:
                    points.append((row["psnr"], row["accuracy"], *row["accuracy_interval"]))
            if points:
                name = f"{name_of(side)}: {title}"
                series.append(Series(name, points, number, filled=attack == "ma_"))
    return series


def _shares(rows: Sequence[Row], attack: str, sides: Sides) -> list[dict[str, Any]]:
    """Return the share of fooled images that the camera, its moiré and the attacker's noise each
    add, baseline first; none of a model that has no image right."""
    rates_of = {row["name"]: row["sides"] for row in rows}
    shares = []
    for kind, side in sides.items():
        names = ("no_moire", "moire", attack)
        camera, photo, attacked = (rates_of[name][kind]["success"].value for name in names)
        if camera is not None:
            added = {"moire": photo - camera, "noise": attacked - photo}
            shares.append({"name": name_of(side), "camera": camera} | added)
    return shares


def _unanswered(sides: Sides) -> list[dict[str, Any]]:
    """Return the number of images without an answer, model by model and row by row."""
    unanswered = []
    for side in sides.values():
        for row in side.reattack or []:
            if row["undecided"]:
                title = f"{name_of(side)}, {title_of(row['name'], 'ladder')}"
                unanswered.append({"undecided": row["undecided"], "n": row["n"], "title": title})
    return unanswered


def _cost(sides: Sides) -> dict[str, Any]:
    """Return the table of what training cost: the models that were trained here, the baseline
    first, and a line for each cost, with the ratio of the two."""
    trains = {name_of(side): side.train for side in sides.values() if side.train}
    lines = []
    for title, name, digits in COST_ROWS if trains else ():
        values = [getattr(train, name) for train in trains.values()]
        ratio = values[-1] / values[0]
        lines.append({"title": title, "figures": values, "digits": digits, "ratio": ratio})
    return {"sides": list(trains), "lines": lines}
