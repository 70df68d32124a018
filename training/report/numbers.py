"""Numbers as reports print them; a dash where one is not known."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from moireaug.synthesis.twins import SEEN_CODES

DASH = "–"
UNITS = ("%", "points", "s", "min", "h")


class Rate(NamedTuple):
    """A rate, None where no image counts, or a difference of two; and its 95 % interval."""

    value: float | None
    low: float
    high: float


def finite(value: Any) -> float | None:
    """Return the number as a float; None where it is missing, not a number or infinite."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if math.isfinite(value) else None


def percent(rate: Any, digits: int = 1) -> str:
    """Return a rate in percent without the sign."""
    known = finite(rate)
    return DASH if known is None else f"{100 * known:.{digits}f}"


def points(difference: Any, digits: int = 1) -> str:
    """Return a difference of two rates in percentage points, with its sign."""
    known = finite(difference)
    if known is None:
        return DASH
    rounded = round(100 * known, digits)
    if not rounded:
        return f"{0:.{digits}f}"
    return f"{rounded:+.{digits}f}".replace("-", "−")


def codes(value: Any) -> str:
    """Return a change in [0, 1] units in units of 1/255."""
    known = finite(value)
    return DASH if known is None else f"{255 * known:.3g}"


def eps_with_unit(row: Mapping[str, Any]) -> str:
    """Return the eps of a row in units of 1/255, and what it counts where there is noise."""
    return f"{codes(row['eps'])} {row['bound']}".strip()


def distinct(counts: Iterable[Any]) -> str:
    """Return the different ones of some counts, joined by slashes; those not known are left out."""
    return " / ".join(dict.fromkeys(str(count) for count in counts if count is not None))


def moire_text(cells: Iterable[Mapping[str, Any]]) -> str:
    """Return how much moiré the photos of some cells have, in words, from their `moire` and
    `moire_seen`; "" where none was measured."""
    known = [cell for cell in cells if finite(cell.get("moire")) is not None]
    if not known:
        return ""
    median = _span(f"{cell['moire']:.2g}" for cell in known)
    seen = _span(f"{100 * cell['moire_seen']:.0f}" for cell in known)
    return f"median {median} codes RMS, {seen} % of photos above {SEEN_CODES:g}"


def _span(figures: Iterable[str]) -> str:
    """Return the least and the greatest of some figures, or the one that there is."""
    ends = sorted(set(figures), key=float)
    return ends[0] if len(ends) == 1 else f"{ends[0]} to {ends[-1]}"


def number(value: Any, digits: int = 1) -> str:
    """Return a number with `digits` decimals."""
    known = finite(value)
    return DASH if known is None else f"{known:,.{digits}f}"


def duration(seconds: Any) -> str:
    """Return seconds as people say them: 4.2 s, 3 min 30 s, 1 h 5 min."""
    known = finite(seconds)
    if known is None:
        return DASH
    if known < 59.95:
        return f"{known:.1f} s"
    minutes, rest = divmod(round(known), 60)
    if minutes < 60:
        return f"{minutes} min {rest} s"
    return f"{minutes // 60} h {minutes % 60} min"


def capital(text: str) -> str:
    """Return a text with its first letter as a capital."""
    return text[:1].upper() + text[1:]


def tied(text: str) -> str:
    """Return a text whose numbers stay on one line with their units. It is plain text, whatever it
    was."""
    text = str.__str__(text)
    for unit in UNITS:
        text = re.sub(rf"(?<=\d) {unit}(?!\w)", f"\N{NO-BREAK SPACE}{unit}", text)
    return text.replace(" = ", "\N{NO-BREAK SPACE}=\N{NO-BREAK SPACE}")


def short(text: str, width: int) -> str:
    """Return a text cut to at most `width` letters."""
    return text if len(text) <= width else text[: width - 1] + "…"
