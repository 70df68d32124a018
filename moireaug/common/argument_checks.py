"""Checks of arguments that all parts of the package share: callables, names and numbers."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from numbers import Integral, Real
from typing import TypeGuard


def check_callable(
    name: str, part: object, output: str = "logits (B, K)", advice: str = ""
) -> None:
    """Refuse what cannot be called, and a class in place of an instance: TypeError."""
    if not callable(part) or isinstance(part, type):
        raise TypeError(
            f"{name} must be a function or a torch module from images (B, 3, H, W) to {output}; "
            f"got {part!r}.{advice}"
        )


def one_of(name: str, got: object, allowed: Iterable[str]) -> str:
    """Return `got` if it is allowed; otherwise raise a ValueError that lists the allowed names and
    suggests the closest."""
    allowed = tuple(allowed)
    if isinstance(got, str) and got in allowed:
        return got
    close = difflib.get_close_matches(str(got), allowed, n=1, cutoff=0.5)
    hint = f" Did you mean {close[0]!r}?" if close else ""
    raise ValueError(f"{name} must be one of {', '.join(map(repr, allowed))}; got {got!r}.{hint}")


def is_finite(value: object) -> TypeGuard[float]:
    """Return whether this is a real number, neither a bool nor NaN nor infinite."""
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)


def check_probability(p: float) -> float:
    """Return `p` if it is a number in [0, 1]; otherwise raise a ValueError."""
    if not is_finite(p) or not 0 <= p <= 1:
        raise ValueError(f"p must be a probability in [0, 1]; got {p!r}.")
    return float(p)


def check_whole(
    name: str, value: object, low: int, high: int | None = None, noun: str = ""
) -> None:
    """Refuse anything but a whole number in [low, high]; TypeError or ValueError. The message adds
    the plural `noun`, as in "the classes to go toward"."""
    allowed = f"a whole number of at least {low}"
    if high is not None:
        allowed = f"a whole number from {low} to {high}"
    if noun:
        allowed += f", {noun}"
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise TypeError(f"{name} must be {allowed}; got {value!r}.")
    if int(value) < low or (high is not None and int(value) > high):
        raise ValueError(f"{name} must be {allowed}; got {value!r}.")


def check_real(
    name: str,
    value: object,
    low: float,
    high: float = math.inf,
    *,
    or_low: bool = False,
    unit: str = "",
) -> None:
    """Refuse anything but a finite number in (low, high], or, with `or_low`, in [low, high];
    TypeError or ValueError. The message adds the unit."""
    allowed = "a finite number"
    if low > -math.inf:
        allowed += f" of at least {low:g}" if or_low else f" above {low:g}"
    if high < math.inf:
        allowed += f", at most {high:g}"
    if unit:
        allowed += f", in {unit}"
    if isinstance(value, bool) or not isinstance(value, Real):
        raise TypeError(f"{name} must be {allowed}; got {value!r}.")
    number = float(value)
    above = number >= low if or_low else number > low
    if not (math.isfinite(number) and above and number <= high):
        raise ValueError(f"{name} must be {allowed}; got {value!r}.")
