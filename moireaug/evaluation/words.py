"""A run's numbers in words: the headline of its report and its table for the terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from moireaug.attacks import UNDECIDED

Metrics = dict[str, Any]
MOST = 4  # rungs that a sentence names


def finite(value: Any) -> float | None:
    """The number as a float; None where it is missing, not a number or infinite."""
    number = float(value) if isinstance(value, int | float) else math.nan
    return number if math.isfinite(number) else None


def interval(values: Any) -> tuple[float, float] | None:
    """Two finite numbers, or None."""
    ends = [v for v in map(finite, values) if v is not None] if isinstance(values, list | tuple) else []
    return (ends[0], ends[1]) if len(ends) == 2 else None


def percent(rate: float | None, digits: int = 1) -> str:
    """A rate in percent without the sign; a dash where there is none."""
    return "–" if rate is None else f"{100 * rate:.{digits}f}"


def points(difference: float | None, digits: int = 1) -> str:
    """A difference of two rates in percentage points, with its sign; a dash where there is none."""
    if difference is None:
        return "–"
    rounded = round(100 * difference, digits)
    return f"{rounded:+.{digits}f}".replace("-", "−") if rounded else f"{0:.{digits}f}"


def span(ends: tuple[float, float] | None) -> str:
    """An interval of a rate, in percent."""
    return f"{percent(ends[0])} – {percent(ends[1])}" if ends else ""


def eps_of(row: Metrics) -> str:
    """The bound of a row's noise in units of 1/255."""
    eps = finite(row.get("eps"))
    return f"{255 * eps:.3g}" if eps else "0"


def answer(predicted: int, classes: Mapping[int, str]) -> str:
    """The name of a predicted class."""
    return "no answer" if predicted == UNDECIDED else classes.get(predicted, str(predicted))


def unanswered(counts: Sequence[tuple[str, int, int]]) -> list[str]:
    """How many images had no answer, as a paragraph; none where all had one.

    Args:
        counts: (what was shown, images without an answer, images) each.
    """
    found = [f"{n} of {total} ({title})" for title, n, total in counts if n]
    if not found:
        return []
    more = f" and {len(found) - MOST} more" if len(found) > MOST else ""
    return [f"Logits that are NaN or infinite are wrong answers here: of {', '.join(found[:MOST])}{more} images."]


def rungs_unanswered(metrics: Metrics) -> list[str]:
    """The same of this model and its baseline, rung by rung."""
    counts = []
    for side, name in zip((metrics, metrics.get("baseline") or {}), names(metrics), strict=True):
        for row in side.get("reattack") or []:
            counts.append((f"{name}, {title_of(row)}", row.get("undecided", 0), row.get("n", 0)))
    return unanswered(counts)


def duration(seconds: float | None) -> str:
    """Seconds as people say them: 4.2 s, 3 min 30 s, 1 h 5 min."""
    if seconds is None:
        return "–"
    if seconds < 59.95:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


def title_of(row: Metrics) -> str:
    return str(row.get("title") or row["name"])


def row_of(side: Metrics | None, name: str) -> Metrics:
    """The row of that name among a model's; empty where it has none."""
    return next((row for row in (side or {}).get("reattack") or [] if row["name"] == name), {})


def names(metrics: Metrics) -> tuple[str, str]:
    """What to call this model and its baseline."""
    recipe = metrics.get("recipe") if metrics.get("recipe") != "pretrained" else None
    ours = str(recipe or metrics.get("model") or "this model")
    return ours, str((metrics.get("baseline") or {}).get("recipe") or "baseline")


def gain(metrics: Metrics, name: str) -> tuple[float | None, tuple[float, float] | None]:
    """Accuracy of this model minus the baseline's on one rung, and its interval."""
    known = finite((metrics.get("gain") or {}).get(name))
    if known is None:
        ours, theirs = (finite(row_of(side, name).get("accuracy")) for side in (metrics, metrics.get("baseline")))
        known = None if ours is None or theirs is None else ours - theirs
    return known, interval((metrics.get("gain_interval") or {}).get(name))


def is_attack(row: Metrics) -> bool:
    """Whether an attacker searches this row's noise; the other rows only show what a camera does."""
    return str(row["name"]).startswith(("ma_", "pgd"))


def main_row(metrics: Metrics) -> Metrics:
    """The row that the headline is about: the plain Moiré Attack at the middle eps, else the last row; may be empty."""
    rows = metrics.get("reattack") or []
    plain = [r for r in rows if r["name"].startswith("ma_") and "_" not in r["name"][3:] and not r.get("targeted")]
    plain.sort(key=lambda r: finite(r.get("eps")) or 0.0)
    return plain[len(plain) // 2] if plain else (rows[-1] if rows else {})


def headline(metrics: Metrics) -> tuple[str, list[str]]:
    """The answer in one line, and the paragraphs under it."""
    row, (ours, theirs), clean = main_row(metrics), names(metrics), finite(metrics.get("clean_accuracy"))
    if not row:
        title = ours if clean is None else f"{ours}: clean accuracy {_share(clean, 1)}"
        return title, [" ".join(["The model was not attacked again.", *_cost(metrics)])]
    plain = row["name"].startswith("ma_")
    attack = f"The Moiré Attack at {eps_of(row)}/255" if plain else f"“{title_of(row)}”"
    under = "accuracy under the Moiré Attack" if plain else f"accuracy under “{title_of(row)}”"
    before, n = row_of(metrics.get("baseline"), row["name"]), f"n = {row.get('n', '?')}"
    if before:
        title, change = _change(metrics, row, under, n)
        difference, _ = gain(metrics, row["name"])
        fooled = [_share(finite(r.get("success")), _digits(difference)) for r in (before, row)]
        lead = f"{attack} fooled {_plain(theirs)} on {fooled[0]} of the images that it had right; it fools {ours} on "
        lead += f"{fooled[1]}. {change}"
        return title, [" ".join([lead, *_cost(metrics)]), *_shares(metrics, row)]
    accuracy, ends = _share(finite(row.get("accuracy"))), interval(row.get("accuracy_interval"))
    between = f"95 % interval {percent(ends[0], 0)} to {percent(ends[1], 0)} %, " if ends else ""
    lead = (
        f"{attack} fools {ours} on {_share(finite(row.get('success')))} of the images that it had right. Accuracy is "
    )
    lead += f"{_share(clean, 1)} on clean images and {accuracy} under attack ({between}{n})."
    alone = "No baseline was attacked beside it, so nothing here says what its training gained."
    return f"{_capital(under)} of {ours}: {accuracy}", [
        " ".join([lead, *_cost(metrics)]),
        *_shares(metrics, row),
        alone,
    ]


def _change(metrics: Metrics, row: Metrics, under: str, n: str) -> tuple[str, str]:
    """From the baseline's accuracy to this model's: as a title, and as a sentence. A change that its interval cannot
    tell from none is called so."""
    baseline, (ours, _) = metrics["baseline"], names(metrics)
    difference, ends = gain(metrics, row["name"])
    digits = _digits(difference)
    before, after = (_share(finite(r.get("accuracy")), digits) for r in (row_of(baseline, row["name"]), row))
    title, verb, caveat = f"{_capital(under)}: {after} with {ours}, {before} without", "went", ""
    if difference is not None and ends and (ends[0] > 0 or ends[1] < 0):
        lifts, verb = ("raises", "rose") if difference > 0 else ("lowers", "fell")
        title = f"{ours} {lifts} {under} from {before} to {after}"
    elif ends:
        title = f"{ours} does not measurably change {under}: {after} against {before}"
        caveat = ", a difference that so many images cannot tell from none"
    moved = f"{points(difference, digits)} points, "
    moved += f"95 % interval {points(ends[0], digits)} to {points(ends[1], digits)}, " if ends else ""
    subject = _capital(under.replace("the Moiré Attack", "attack"))
    sentence = f"{subject} {verb} from {before} to {after} ({moved}{n}){caveat}"
    cleans = [_share(finite(side.get("clean_accuracy")), 1) for side in (baseline, metrics)]
    return title, f"{sentence}; clean accuracy went from {cleans[0]} to {cleans[1]}."


def _shares(metrics: Metrics, row: Metrics) -> list[str]:
    """What the camera, its moiré and the attacker's noise each add to the images fooled."""
    both, (ours, theirs) = [], names(metrics)
    for side, name in ((metrics.get("baseline"), _plain(theirs)), (metrics, ours)):
        smooth, photo, attacked = (finite(row_of(side, r).get("success")) for r in ("no_moire", "moire", row["name"]))
        if smooth is not None and photo is not None and attacked is not None:
            steps = [points(later - sooner, 0).lstrip("+") for sooner, later in ((smooth, photo), (photo, attacked))]
            both.append((name, f"{percent(smooth, 0)} %", *steps))
    if not both or not is_attack(row):
        return []
    name, camera, moire, noise = both[0]
    text = f"Where these mistakes come from: the camera without moiré fools {name} on {camera}; to that the moiré adds "
    text += f"{moire} and the attacker’s noise {noise} points"
    text += "; with {} it is {}, {} and {} points.".format(*both[1]) if len(both) == 2 else "."
    return [text]


def _plain(name: str) -> str:
    return "the plainly trained model" if name == "clean" else name


def _digits(difference: float | None) -> int:
    """Small differences need a decimal."""
    return 0 if difference is not None and abs(difference) >= 0.05 else 1


def _share(rate: float | None, digits: int = 0) -> str:
    return "an unknown share" if rate is None else f"{percent(rate, digits)} %"


def _cost(metrics: Metrics) -> list[str]:
    sides = (metrics.get("train") or {}), ((metrics.get("baseline") or {}).get("train") or {})
    seconds, base = (finite(side.get("seconds")) for side in sides)
    if seconds is None:
        return []
    if not base:
        return [f"Training took {duration(seconds)}."]
    if sides[0].get("init") == "clean":
        total = f"{duration(seconds + base)} in all, {(seconds + base) / base:.1f} times the baseline"
        return [f"Training took {duration(seconds)} from the baseline’s weights, which took {duration(base)}: {total}."]
    return [f"Training took {duration(seconds)}, {seconds / base:.1f} times the {duration(base)} of the baseline."]


def summary(metrics: Metrics) -> str:
    """The ladder as a table of at most 100 columns: accuracy of both models and the gain, or of this model alone."""
    rows, baseline = metrics.get("reattack") or [], metrics.get("baseline") or {}
    both = bool(baseline.get("reattack"))
    ours, theirs = (_short(name, 13) for name in names(metrics))
    facts = [metrics.get("data"), metrics.get("model"), metrics.get("scene_name")]
    n = f"n = {rows[0].get('n')}" if rows else "not attacked"
    lines = [", ".join([*(_short(str(f), 18) for f in facts if f), n, "accuracy in %, eps in 1/255"])]
    head = f"{theirs:>13}  {ours:>13}  {'gain, points [95 %]':>24}" if both else f"{ours:>13}  {'95 %':>14}"
    lines += [f"{'':32}  {'eps':>5}  {head}"] if rows else []
    for row in rows:
        mine = percent(finite(row.get("accuracy")))
        cells = f"{mine:>13}  {span(interval(row.get('accuracy_interval'))):>14}"
        if both:
            difference, ends = gain(metrics, row["name"])
            text = points(difference) + (f"  [{points(ends[0])}, {points(ends[1])}]" if ends else "")
            cells = f"{percent(finite(row_of(baseline, row['name']).get('accuracy'))):>13}  {mine:>13}  {text:>24}"
        lines.append(f"{_short(title_of(row), 32):32}  {eps_of(row):>5}  {cells}")
    took = [
        (name, finite((side.get("train") or {}).get("seconds"))) for name, side in ((theirs, baseline), (ours, metrics))
    ]
    told = ", ".join(f"{name} {duration(s)}" for name, s in took if s is not None)
    on_top = took[0][1] if (metrics.get("train") or {}).get("init") == "clean" else 0.0
    ratio = ""
    if took[0][1] and took[1][1] is not None:
        ratio = f" ({'from its weights, ' if on_top else ''}{(took[1][1] + on_top) / took[0][1]:.1f} times in all)"
    lines += [f"training: {told}{ratio}"] if told else []
    return "\n".join([*lines, *rungs_unanswered(metrics)])


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _short(text: str, width: int) -> str:
    return text if len(text) <= width else text[: width - 1] + "…"
