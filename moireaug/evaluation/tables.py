"""The report's tables, as HTML: every rung, where the time went, what training cost."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

from moireaug.evaluation.words import (
    Metrics,
    duration,
    eps_of,
    finite,
    gain,
    interval,
    is_attack,
    names,
    percent,
    points,
    row_of,
    span,
    title_of,
)


def rungs(metrics: Metrics) -> str:
    """A line per rung: the models' rates with intervals, the gain, seconds and n; empty where nothing was attacked."""
    rows, baseline = metrics.get("reattack") or [], metrics.get("baseline") or {}
    if not rows:
        return ""
    both = bool(baseline.get("reattack"))
    sides = [baseline, metrics] if both else [metrics]
    labels = [escape(name) for name in reversed(names(metrics))][-len(sides) :]
    # every rung counts the images that are right when clean, so that one denominator serves a whole column
    of = [" / ".join(str(c) for c in dict.fromkeys(r.get("counted", "?") for r in side["reattack"])) for side in sides]
    fooled = [f"{label}<br>of {count}" for label, count in zip(labels, of, strict=True)]
    wide = f' scope="colgroup" colspan="{len(sides)}"'
    tops = [f"<th{wide}>accuracy, %</th>", f"<th{wide}>fooled, %</th>", f"<th{wide}>time, s</th>"]
    tall = '<th scope="col" rowspan="2">{}</th>'.format
    if both:
        tops.insert(1, tall("gain,<br>points"))
    head = f'<tr>{tall("rung")}{tall("eps,<br>1/255")}{"".join(tops)}{tall("n")}</tr>\n<tr class="sub">'
    head += "".join(f'<th scope="col">{label}</th>' for label in (*labels, *fooled, *labels)) + "</tr>"
    body = []
    for i, row in enumerate(rows):
        found = [row_of(side, row["name"]) for side in sides]
        cells = [_cell(eps_of(row)), *(_rate(r, "accuracy") for r in found)]
        if both:
            difference, ends = gain(metrics, row["name"])
            cells.append(_cell(points(difference), f"{points(ends[0])} to {points(ends[1])}" if ends else ""))
        cells += [*(_rate(r, "success") for r in found), *(_cell(_number(r.get("seconds"))) for r in found)]
        first = i and is_attack(row) and not is_attack(rows[i - 1])
        body.append(_line(title_of(row), [*cells, _cell(str(row.get("n", "–")))], "first-attack" if first else ""))
    caption = (
        "Every rung. Small print: 95 % intervals. Being fooled is counted on the images that the model had right when "
        "clean; “of” says how many. Targeted: fooled means that the attacker’s class is given. Time: for all n images."
    )
    return framed(head, body, caption, "ladder")


def phases(metrics: Metrics) -> str:
    """Where this run's time went; empty where nothing was timed."""
    known = {k: s for k, v in (metrics.get("time") or {}).items() if (s := finite(v)) is not None}
    total = sum(known.values())
    if total <= 0:
        return ""
    body = []
    for name, seconds in known.items():
        bar = f'<td class="wide"><i style="width: {100 * seconds / total:.2f}%"></i></td>'
        body.append(_line(name, [_cell(duration(seconds)), _cell(f"{percent(seconds / total)} %"), bar]))
    return framed(_heads("phase", "time", "share", ""), body, f"Where the {duration(total)} of this run went.")


def cost(metrics: Metrics) -> str:
    """What training cost, beside the baseline's where it is known; empty for a model that was not trained here."""
    ours, theirs = (side.get("train") or {} for side in (metrics, metrics.get("baseline") or {}))
    if not ours:
        return ""
    heads = _heads("", *reversed(names(metrics)), "ratio") if theirs else _heads("", names(metrics)[0])
    body = []
    quantities = (
        ("training time, s", "seconds", 1),
        ("epochs", "epochs", 0),
        ("images per second", "images_per_second", 0),
    )
    for title, key, digits in (*quantities, ("passes per image", "passes", 2)):
        body.append(_cost_line(title, [finite(t.get(key)) for t in (theirs, ours)], digits, bool(theirs)))
    image = [1000 / rate if (rate := finite(t.get("images_per_second"))) else None for t in (theirs, ours)]
    body.insert(3, _cost_line("time per image, ms", image, 2, bool(theirs)))
    passes = [finite(t.get("passes")) for t in (theirs, ours)]
    each = [ms / n if ms is not None and n else None for ms, n in zip(image, passes, strict=True)]
    body.append(_cost_line("time per pass, ms", each, 2, bool(theirs)))
    caption = "What training cost, one run each. A pass is forward and backward through the model."
    return framed(heads, body, caption)


def trust(metrics: Metrics, only: str | None = None) -> str:
    """Whether the figures can be trusted, check by check; with `only`, those of that verdict. Empty without any."""
    checks = [c for c in metrics.get("trust") or [] if only in (None, c["verdict"])]
    if not checks:
        return ""
    sign = {"pass": ("right", "✓ pass"), "warning": ("wrong", "! warning"), "fail": ("wrong", "✗ fail")}
    body = []
    for check in checks:
        kind, text = sign[check["verdict"]]
        cells = f'<td class="says"><span class="{kind}">{text}</span></td><td class="says">{escape(check["says"])}</td>'
        body.append(_line(check["name"], [cells]))
    caption = f"Images fooled by the attack and its variants, on {metrics.get('trust_n', 'the first')} test images."
    table = framed(_heads("check", "", "figures"), body, caption, "trust")
    title = "These checks failed: do not rely on the figures below" if only == "fail" else "Can it be trusted?"
    return f"<section><h2>{title}</h2>\n{table}</section>"


def _cost_line(title: str, pair: Sequence[float | None], digits: int, both: bool) -> str:
    theirs, ours = pair
    ratio = f"{ours / theirs:.2f}" if ours is not None and theirs else "–"
    texts = [_number(theirs, digits), _number(ours, digits), ratio] if both else [_number(ours, digits)]
    return _line(title, map(_cell, texts))


def framed(head: str, lines: Iterable[str], caption: str, kind: str = "") -> str:
    """A table under its caption, which stays where it is when a wide table is scrolled."""
    body = "\n".join(lines)
    return (
        f'<figure class="table {kind}"><figcaption>{caption}</figcaption>\n<div class="scroll"><table>\n'
        f"<thead>{head}</thead>\n<tbody>{body}</tbody></table></div></figure>"
    )


def _heads(*titles: str) -> str:
    return "<tr>" + "".join(f'<th scope="col">{escape(t)}</th>' for t in titles) + "</tr>"


def _line(title: str, cells: Iterable[str], kind: str = "") -> str:
    return f'<tr class="{kind}"><th scope="row">{escape(title)}</th>' + "".join(cells) + "</tr>"


def _cell(value: str, below: str = "") -> str:
    return f"<td>{escape(value)}" + (f"<small>{escape(below)}</small></td>" if below else "</td>")


def _rate(row: Metrics, key: str) -> str:
    return _cell(percent(finite(row.get(key))), span(interval(row.get(f"{key}_interval"))))


def _number(value: Any, digits: int = 1) -> str:
    number = finite(value)
    return "–" if number is None else f"{number:,.{digits}f}"
