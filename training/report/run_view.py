"""The view of a run: numbers from its metrics, computed once for the page and the terminal."""

from collections.abc import Mapping, Sequence
from typing import Any

from moireaug.evaluation.frame import MEASURES, MOIRE_MEASURES
from training.report.numbers import Rate, distinct, moire_text
from training.report.page import name_of, title_of
from training.report.plots import Series
from training.runs.metrics import PlainMetrics, RunMetrics, TrainCost

MIN_WHOLE_CHANGE = 0.05  # the smallest change of rates that is printed without decimals
Sides = Mapping[str, RunMetrics | PlainMetrics]  # "baseline" where there is one, and "ours"
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
    baseline, train = metrics.baseline, metrics.train
    sides: Sides = {"baseline": baseline, "ours": metrics} if baseline else {"ours": metrics}
    rows = _rows(metrics, sides)
    main = next((row for row in rows if row["headline"]), rows[-1])
    trains = {name_of(side): side.train for side in sides.values() if side.train}
    return {
        "name": name_of(metrics),
        "baseline": name_of(baseline) if baseline else None,
        "is_pretrained": train is not None and train.init == "clean",
        "sides": [_side(kind, side) for kind, side in sides.items()],
        "rows": rows,
        "main": main,
        "noise": [row for row in rows if row["psnr"] is not None],
        "visibility": _visibility(sides),
        "moire": moire_text(rows),
        "has_lpips": any(row["lpips"] is not None for row in rows),
        "clean": metrics.clean_accuracy,
        "clean_theirs": baseline.clean_accuracy if baseline else None,
        "change": _change(main["gain"]) if baseline else None,
        "digits": 0 if baseline and abs(main["gain"].value) >= MIN_WHOLE_CHANGE else 1,
        "seconds": train.total_seconds if train else None,
        "seconds_theirs": baseline.train.total_seconds if baseline and baseline.train else None,
        "collapsed_at": train.collapsed_at if train else None,
        "collapsed_last": train and train.collapsed_at == len(train.history) - 1,
        "unanswered": _unanswered(sides),
        "shares": _shares(rows, main, sides),
        "cost": {"sides": list(trains), "lines": _cost_lines(list(trains.values()))},
    }


def _side(kind: str, side: RunMetrics | PlainMetrics) -> dict[str, Any]:
    counted = distinct(row["counted"] for row in side.reattack or [])
    return {"kind": kind, "name": name_of(side), "counted": counted}


def _rows(metrics: RunMetrics, sides: Sides) -> list[Row]:
    """Return the rows of the ladder, with every side's rates and the gain over the baseline."""
    rows: list[Row] = []
    for number, line in enumerate(metrics.reattack or []):
        rates = {}
        for kind, side in sides.items():
            own = (side.reattack or [])[number]
            rates[kind] = {
                name: Rate(own[name], *own[f"{name}_interval"]) for name in ("accuracy", "success")
            }
        name, is_attack = line["name"], not line["control"]
        row = dict.fromkeys((*MEASURES, *MOIRE_MEASURES)) | {"headline": False, "gain": None} | line
        if metrics.baseline:
            row["gain"] = Rate(metrics.gain[name], *metrics.gain_interval[name])
        row |= {"title": title_of(name, "ladder"), "sides": rates, "attack": is_attack}
        row["first_attack"] = is_attack and bool(rows) and not rows[-1]["attack"]
        rows.append(row)
    return rows


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


def _change(gain: Rate) -> str:
    """Return "raises" or "lowers"; "unclear" where the interval cannot tell the change from
    none."""
    if gain.low <= 0 <= gain.high:
        return "unclear"
    return "raises" if gain.low > 0 else "lowers"


def _shares(rows: Sequence[Row], main: Row, sides: Sides) -> list[dict[str, Any]]:
    """Return the share of fooled images that the camera, its moiré and the attacker's noise each
    add, baseline first."""
    by_name = {row["name"]: row for row in rows}
    shares = []
    for kind, side in sides.items():
        successes = []
        for name in ("no_moire", "moire", main["name"]):
            successes.append(by_name[name]["sides"][kind]["success"].value)
        camera, photo, attacked = successes
        if camera is not None:  # where the model has any image right
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


def _cost_lines(trains: Sequence[TrainCost]) -> list[dict[str, Any]]:
    """Return the costs of training, of the baseline and this model, and the ratio of the two."""
    lines = []
    for title, name, digits in COST_ROWS if trains else ():
        values = [getattr(train, name) for train in trains]
        ratio = values[-1] / values[0]
        lines.append({"title": title, "figures": values, "digits": digits, "ratio": ratio})
    return lines
