"""The view of a run: numbers from its metrics, computed once for the page and the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from training.report.metrics import (
    Metrics,
    Rate,
    gain_of,
    is_attack,
    name_of,
    rate_of,
    row_of,
    total_seconds,
)
from training.report.numbers import distinct, finite
from training.report.page import title_of

MIN_WHOLE_CHANGE = 0.05  # the smallest change of rates that is printed without decimals


def run_view(metrics: Metrics) -> dict[str, Any]:
    """Return the values for the templates of a run. Entries of the metrics may be missing; None and
    NaN stand for unknown."""
    known = {"baseline": metrics.get("baseline"), "ours": metrics}
    sides = {}
    clean_accuracies = {}
    for kind, side in known.items():
        clean_accuracies[kind] = finite((side or {}).get("clean_accuracy"))
        if side and side.get("reattack"):
            sides[kind] = side
    baseline = sides.get("baseline")
    rows = _rows(metrics, sides)
    main = _main(metrics, rows, sides)
    train = metrics.get("train") or {}
    view = {
        "name": name_of(metrics),
        "baseline": name_of(baseline) if baseline else None,
        "is_pretrained": train.get("init") == "clean",
        "sides": [_side(kind, side) for kind, side in sides.items()],
        "rows": rows,
        "n": rows[0]["n"] if rows else None,
        "main": main,
        "noise": [row for row in rows if row["psnr"] is not None],
        "has_lpips": any(row["lpips"] is not None for row in rows),
        "clean": clean_accuracies["ours"],
        "clean_theirs": clean_accuracies["baseline"],
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
        is_wide = abs(main["gain"].value or 0.0) >= MIN_WHOLE_CHANGE
        view["digits"] = 0 if is_wide else 1
    return view


def _side(kind: str, side: Metrics) -> dict[str, Any]:
    name = name_of(side)
    role = "this model" if kind == "ours" else kind
    label = role if role == name else f"{role} ({name})"
    counted = distinct(row.get("counted") for row in side["reattack"])
    return {"kind": kind, "name": name, "label": label, "counted": counted}


def _rows(metrics: Metrics, sides: Mapping[str, Metrics]) -> list[dict[str, Any]]:
    """Return the rows of the ladder, with every side's rates and the gain over the baseline."""
    rows: list[dict[str, Any]] = []
    for line in metrics.get("reattack") or []:
        rates = {}
        for kind, side in sides.items():
            theirs = row_of(side, line["name"])
            rates[kind] = {
                "accuracy": rate_of(theirs, "accuracy"),
                "success": rate_of(theirs, "success"),
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
            "gain": gain_of(metrics, line["name"]),
            "seconds": finite(line.get("seconds")),
            "n": line.get("n"),
        }
        for name in ("largest", "psnr", "ssim", "lpips"):
            row[name] = finite(line.get(name))
        rows.append(row)
    return rows


def _main(
    metrics: Metrics, rows: Sequence[dict[str, Any]], sides: Mapping[str, Metrics]
) -> dict[str, Any] | None:
    """Return the headline's row: the plain Moiré Attack at the middle eps, else the
    last row."""
    if not rows:
        return None
    plain_attacks = []
    for row in rows:
        line = row_of(metrics, row["name"])
        name = str(row["name"])
        if name.startswith("ma_") and "_" not in name[3:] and not line.get("targeted"):
            plain_attacks.append(row)
    plain_attacks.sort(key=lambda row: row["eps"])
    row = plain_attacks[len(plain_attacks) // 2] if plain_attacks else rows[-1]
    accuracy = row["sides"]["ours"]["accuracy"]
    accuracies = {kind: row["sides"][kind]["accuracy"].value for kind in sides}
    return row | {
        "is_ma": bool(plain_attacks),
        "ours": accuracy.value,
        "low": accuracy.low,
        "high": accuracy.high,
        "success": row["sides"]["ours"]["success"].value,
        "theirs": accuracies.get("baseline"),
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
    """Return the share of fooled images that the camera, its moiré and the attacker's noise each
    add, baseline first."""
    if main is None or not main["attack"]:
        return []
    by_name = {row["name"]: row for row in rows}
    shares = []
    for kind in ("baseline", "ours"):
        if kind not in sides:
            continue
        successes = []
        for name in ("no_moire", "moire", main["name"]):
            row = by_name.get(name)
            successes.append(row["sides"][kind]["success"].value if row else None)
        camera, photo, attacked = successes
        if camera is not None and photo is not None and attacked is not None:
            model, moire, noise = name_of(sides[kind]), photo - camera, attacked - photo
            shares.append({"name": model, "camera": camera, "moire": moire, "noise": noise})
    return shares


def _unanswered(sides: Mapping[str, Metrics]) -> list[dict[str, Any]]:
    """Return the number of images without an answer, model by model and row by row."""
    unanswered = []
    for side in sides.values():
        for row in side["reattack"]:
            if finite(row.get("undecided")):
                title = f"{name_of(side)}, {title_of(row['name'], 'ladder')}"
                counts = {"undecided": row["undecided"], "n": row.get("n", 0)}
                unanswered.append(counts | {"title": title})
    return unanswered


def _cost(metrics: Metrics, baseline: Metrics | None) -> dict[str, Any] | None:
    """Return the costs of training, next to the baseline's where they are known."""
    if not metrics.get("train"):
        return None
    sides = {}
    if (baseline or {}).get("train"):
        sides[name_of(baseline or {})] = (baseline or {})["train"]
    sides[name_of(metrics)] = metrics["train"]
    cost_rows = (
        ("training time, s", "total_seconds", "seconds", 1),
        ("epochs", "total_epochs", "epochs", 0),
        ("images per second", "images_per_second", None, 0),
        ("passes per image and epoch", "passes", None, 2),
    )
    lines = []
    for title, key, fallback, digits in cost_rows:
        values = []
        for train in sides.values():
            value = finite(train.get(key))
            if value is None and fallback:
                value = finite(train.get(fallback))
            values.append(value)
        lines.append({"title": title, "figures": values, "digits": digits, "ratio": _ratio(values)})
    return {"sides": list(sides), "lines": lines}


def _ratio(values: Sequence[float | None]) -> float | None:
    """Return the ratio of the last of two costs to the first; None where either is not known."""
    first, last = values[0], values[-1]
    if not first or last is None:
        return None
    return last / first
