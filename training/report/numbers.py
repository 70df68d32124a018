"""Numbers as reports print them; a dash where one is not known."""

import functools
import math
import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

from moireaug.synthesis.twins import SEEN_CODES

DASH = "–"
NUMBER_BEFORE_UNIT = re.compile(r"(?<=\d) (%|points|s|min|h)(?!\w)")


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


def dash_for_unknown(text_of: Callable[..., str]) -> Callable[..., str]:
    """Return a function that prints numbers, with a dash for what is no finite one."""

    @functools.wraps(text_of)
    def text_or_dash(value: Any, *digits: int) -> str:
        number = finite(value)
        return DASH if number is None else text_of(number, *digits)

    return text_or_dash


@dash_for_unknown
def number(value: float, digits: int = 1) -> str:
    """Return a number with `digits` decimals."""
    return f"{value:,.{digits}f}"


@dash_for_unknown
def percent(rate: float, digits: int = 1) -> str:
    """Return a rate in percent without the sign."""
    return f"{100 * rate:.{digits}f}"


@dash_for_unknown
def points(difference: float, digits: int = 1) -> str:
    """Return a difference of two rates in percentage points, with its sign."""
    rounded = round(100 * difference, digits)
    sign = "+" if rounded else ""
    return f"{rounded or 0.0:{sign}.{digits}f}".replace("-", "−")


@dash_for_unknown
def codes(value: float) -> str:
    """Return a change in [0, 1] units in units of 1/255."""
    return f"{255 * value:.3g}"


@dash_for_unknown
def duration(seconds: float) -> str:
    """Return seconds as people say them: 4.2 s, 3 min 30 s, 1 h 5 min."""
    if seconds < 59.95:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest} s"
    return f"{minutes // 60} h {minutes % 60} min"


def eps_with_unit(row: Mapping[str, Any]) -> str:
    """Return the eps of a row in units of 1/255, and what it counts where there is noise."""
    return f"{codes(row['eps'])} {row['bound']}".strip()


def distinct(counts: Iterable[Any]) -> str:
    """Return the different ones of some counts, joined by slashes; those not known are left out."""
    return " / ".join(dict.fromkeys(str(count) for count in counts if count is not None))


def moire_text(cells: Iterable[Mapping[str, Any]]) -> str:
    """Return how much moiré the photos of some cells have, in words, from their `moire` and
    `moire_seen`; "" where none was measured."""
    measured = [cell for cell in cells if finite(cell.get("moire")) is not None]
    if not measured:
        return ""
    median = _span(f"{cell['moire']:.2g}" for cell in measured)
    share = _span(f"{100 * cell['moire_seen']:.0f}" for cell in measured)
    return f"median {median} codes RMS, {share} % of photos above {SEEN_CODES:g}"


def _span(figures: Iterable[str]) -> str:
    """Return the least and the greatest of some figures, or the one that there is."""
    ends = sorted(set(figures), key=float)
    return ends[0] if len(ends) == 1 else f"{ends[0]} to {ends[-1]}"


def capital(text: str) -> str:
    """Return a text with its first letter as a capital."""
    return text[:1].upper() + text[1:]


def tied(text: str) -> str:
    """Return a text whose numbers stay on one line with their units. It is plain text, whatever it
    was."""
    text = NUMBER_BEFORE_UNIT.sub("\N{NO-BREAK SPACE}\\1", str.__str__(text))
    return text.replace(" = ", "\N{NO-BREAK SPACE}=\N{NO-BREAK SPACE}")


def short(text: str, width: int) -> str:
    """Return a text cut to at most `width` letters."""
    return text if len(text) <= width else text[: width - 1] + "…"
