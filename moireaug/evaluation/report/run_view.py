"""What the report of a run shows: numbers from its metrics, computed once for the page and the
terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from moireaug.evaluation.report.numbers import finite
from moireaug.evaluation.report.page import title_of

Metrics = Mapping[str, Any]
WIDE_CHANGE = 0.05  # a change of rates from which on no decimal is shown


@dataclass(frozen=True)
class Rate:
    """A rate and its 95 % interval; None where it is not known."""

    value: float | None = None
    low: float | None = None
    high: float | None = None


def run_view(metrics: Metrics) -> dict[str, Any]:
    """Return what the templates of a run need. Entries of the metrics may be missing; None and NaN
    stand for unknown."""
    known = {"baseline": metrics.get("baseline"), "ours": metrics}
    sides = {}
    cleans = {}
    for kind, side in known.items():
        cleans[kind] = finite((side or {}).get("clean_accuracy"))
        if side and side.get("reattack"):
            sides[kind] = side
    baseline = sides.get("baseline")
    rows = _rows(metrics, sides)
    main = _main(metrics, rows, sides)
    train = metrics.get("train") or {}
    view = {
        "name": name_of(metrics),
        "baseline": name_of(baseline) if baseline else None,
        "started": train.get("init") == "clean",
        "sides": [_side(kind, side) for kind, side in sides.items()],
        "rows": rows,
        "n": rows[0]["n"] if rows else None,
        "main": main,
        "noise": [row for row in rows if row["psnr"] is not None],
        "has_lpips": any(row["lpips"] is not None for row in rows),
        "clean": cleans["ours"],
        "clean_theirs": cleans["baseline"],
        "change": None,
        "digits": 0,
        "seconds": total_seconds(metrics),
        "seconds_theirs": total_seconds(known["baseline"]),
        "collapsed_at": train.get("collapsed_at"),
        "collapsed_last": train.get("collapsed_at") == len(train.get("history") or ()) - 1,
        "unanswered": _unanswered(sides),
        "shares": _shares(rows, main, sides),
        "cost": _cost(metrics, known["baseline"]),
    }
    if main and baseline:
        view["change"] = _change(main["gain"])
        wide = abs(main["gain"].value or 0.0) >= WIDE_CHANGE
        view["digits"] = 0 if wide else 1
    return view


def name_of(side: Metrics) -> str:
    """Return what to call a model: its recipe, or its architecture where it was not trained
    here."""
    recipe = side.get("recipe")
    if recipe and recipe != "pretrained":
        return str(recipe)
    return str(side.get("model") or "this model")


def total_seconds(side: Metrics | None) -> float | None:
    """Return the seconds that training took, including those of the weights that it started
    from."""
    train = (side or {}).get("train") or {}
    total = finite(train.get("total_seconds"))
    return finite(train.get("seconds")) if total is None else total


def _side(kind: str, side: Metrics) -> dict[str, Any]:
    name = name_of(side)
    role = "this model" if kind == "ours" else kind
    label = role if role == name else f"{role} ({name})"
    counts: list[str] = []
    for row in side["reattack"]:
        counted = row.get("counted")
        if counted is not None and str(counted) not in counts:
            counts.append(str(counted))
    return {"kind": kind, "name": name, "label": label, "counted": " / ".join(counts)}


def _rows(metrics: Metrics, sides: Mapping[str, Metrics]) -> list[dict[str, Any]]:
    """Return a row per rung, with every side's rates and the gain over the baseline."""
    rows: list[dict[str, Any]] = []
    for line in metrics.get("reattack") or []:
        rates = {}
        for kind, side in sides.items():
            theirs = row_of(side, line["name"])
            rates[kind] = {
                "accuracy": _rate(theirs, "accuracy"),
                "success": _rate(theirs, "success"),
            }
        attack = is_attack(line)
        first = attack and bool(rows) and not rows[-1]["attack"]
        row = {
            "name": line["name"],
            "title": title_of(line["name"], "ladder"),
            "attack": attack,
            "first_attack": first,
            "eps": finite(line.get("eps")) or 0.0,
            "sides": rates,
            "gain": gain(metrics, line["name"]),
            "seconds": finite(line.get("seconds")),
            "n": line.get("n"),
        }
        for name in ("largest", "psnr", "ssim", "lpips"):
            row[name] = finite(line.get(name))
        rows.append(row)
    return rows


def is_attack(line: Metrics) -> bool:
    """Return whether an attacker searches for this row's noise; the others only show what a camera
    does."""
    control = line.get("control")
    return not control if control is not None else str(line["name"]).startswith(("ma_", "pgd"))


def row_of(side: Metrics | None, name: str) -> Metrics:
    """Return a model's row of that name; empty where it has none."""
    for row in (side or {}).get("reattack") or []:
        if row["name"] == name:
            return row
    return {}


def _rate(row: Metrics, key: str) -> Rate:
    ends = row.get(f"{key}_interval") or (None, None)
    return Rate(finite(row.get(key)), *_both(ends))


def _both(ends: Sequence[Any]) -> tuple[float | None, float | None]:
    """Return two finite ends, or none."""
    low, high = (finite(end) for end in ends)
    return (None, None) if low is None or high is None else (low, high)


def gain(metrics: Metrics, name: str) -> Rate:
    """Return the accuracy of this model minus the baseline's on one rung, and its interval."""
    value = finite((metrics.get("gain") or {}).get(name))
    ends = (metrics.get("gain_interval") or {}).get(name) or (None, None)
    return Rate(value, *_both(ends))


def _main(
    metrics: Metrics, rows: Sequence[dict[str, Any]], sides: Mapping[str, Metrics]
) -> dict[str, Any] | None:
    """Return the row that the headline is about: the plain Moiré Attack at the middle eps, else the
    last row."""
    if not rows:
        return None
    plain = []
    for row in rows:
        line = row_of(metrics, row["name"])
        name = str(row["name"])
        if name.startswith("ma_") and "_" not in name[3:] and not line.get("targeted"):
            plain.append(row)
    plain.sort(key=lambda row: row["eps"])
    row = plain[len(plain) // 2] if plain else rows[-1]
    own = row["sides"]["ours"]["accuracy"]
    theirs = {kind: row["sides"][kind]["accuracy"].value for kind in sides}
    return row | {
        "is_ma": bool(plain),
        "ours": own.value,
        "low": own.low,
        "high": own.high,
        "success": row["sides"]["ours"]["success"].value,
        "theirs": theirs.get("baseline"),
    }


def _change(gain: Rate) -> str | None:
    """Return "raises" or "lowers"; "unclear" where the interval cannot tell the change from none;
    None where the interval is not known."""
    if gain.value is None or gain.low is None or gain.high is None:
        return None
    if gain.low <= 0 <= gain.high:
        return "unclear"
    return "raises" if gain.value > 0 else "lowers"


def _shares(
    rows: Sequence[dict[str, Any]], main: dict[str, Any] | None, sides: Mapping[str, Metrics]
) -> list[dict[str, Any]]:
    """Return what the camera, its moiré and the attacker's noise each add to the images fooled,
    baseline first."""
    if main is None or not main["attack"]:
        return []
    by_name = {row["name"]: row for row in rows}
    found = []
    for kind in ("baseline", "ours"):
        if kind not in sides:
            continue
        seen = []
        for name in ("no_moire", "moire", main["name"]):
            row = by_name.get(name)
            seen.append(row["sides"][kind]["success"].value if row else None)
        camera, photo, attacked = seen
        if camera is not None and photo is not None and attacked is not None:
            own = name_of(sides[kind])
            found.append(
                {"name": own, "camera": camera, "moire": photo - camera, "noise": attacked - photo}
            )
    return found


def _unanswered(sides: Mapping[str, Metrics]) -> list[dict[str, Any]]:
    """Return how many images had no answer, model by model and rung by rung."""
    found = []
    for side in sides.values():
        for row in side["reattack"]:
            if finite(row.get("undecided")):
                shown = f"{name_of(side)}, {title_of(row['name'], 'ladder')}"
                found.append({"undecided": row["undecided"], "n": row.get("n", 0), "shown": shown})
    return found


def _cost(metrics: Metrics, baseline: Metrics | None) -> dict[str, Any] | None:
    """Return what training cost, next to the baseline's where it is known."""
    if not metrics.get("train"):
        return None
    sides = {}
    if (baseline or {}).get("train"):
        sides[name_of(baseline or {})] = (baseline or {})["train"]
    sides[name_of(metrics)] = metrics["train"]
    asked = (
        ("training time, s", "total_seconds", "seconds", 1),
        ("epochs", "total_epochs", "epochs", 0),
        ("images per second", "images_per_second", None, 0),
        ("passes per image and epoch", "passes", None, 2),
    )
    lines = []
    for title, key, otherwise, digits in asked:
        values = []
        for train in sides.values():
            value = finite(train.get(key))
            if value is None and otherwise:
                value = finite(train.get(otherwise))
            values.append(value)
        lines.append({"title": title, "figures": values, "digits": digits, "ratio": _ratio(values)})
    return {"sides": list(sides), "lines": lines}


def _ratio(values: Sequence[float | None]) -> float | None:
    """Return the ratio of the last of two costs to the first; None where either is not known."""
    first, last = values[0], values[-1]
    if not first or last is None:
        return None
    return last / first
