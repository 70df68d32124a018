"""Fields of a scene: numbers or ranges with bounds, checked at construction, with error messages
that give the bounds."""

from __future__ import annotations

import contextlib
import math
from dataclasses import Field, field, fields
from numbers import Real
from typing import Any, ClassVar, Self

Range = float | tuple[float, float]
RANGE = "a number or a (low, high) pair of numbers"


def ranged(
    default: Range, low: float, high: float, unit: str = "", stated_from: float | None = None
) -> Any:
    """Declare a field that is a number or a `(low, high)` pair inside the given bounds.

    stated_from: of a field that 0 leaves unstated, the least number that states it; 0 is any above.
    """
    limits = {"low": low, "high": high, "unit": unit}
    return field(default=default, metadata={**limits, "stated_from": stated_from})


def check_number(
    name: str, value: object, low: float, high: float, unit: str, allowed: str = "a number"
) -> float:
    """Return a finite number in [low, high] as a float; refuse others: TypeError, ValueError."""
    if isinstance(value, bool) or not isinstance(value, Real):
        hint = ""
        with contextlib.suppress(ValueError):
            if isinstance(value, str):  # as YAML takes 5e-1
                hint = f" It is text: write {float(value)}."
        raise TypeError(f"{name} must be {allowed}; got {value!r}.{hint}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number) or number < low or number > high:
        raise ValueError(
            f"{name} must lie in [{low:g}, {high:g}]{' ' + unit if unit else ''}; got {value!r}."
        )
    return number


class Part:
    """Checks every ranged and boolean field at construction; drawn ones, which have a shape, pass.
    `ranged` names the class's ranged fields, in the order in which they are drawn."""

    ranged: ClassVar[tuple[str, ...]] = ()
    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]  # every part is a dataclass

    def __init_subclass__(cls) -> None:
        declared = [name for name, value in vars(cls).items() if isinstance(value, Field)]
        cls.ranged = tuple(name for name in declared if "low" in vars(cls)[name].metadata)

    def drawn(self, values: dict[str, Any]) -> Self:
        """Return the same part with drawn numbers for its ranged fields, unchecked."""
        part = object.__new__(type(self))
        # not vars(part).update(...), which torch.compile does not follow
        for name in self.__dataclass_fields__:
            value = values[name] if name in values else getattr(self, name)
            object.__setattr__(part, name, value)
        return part

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            name = f"{type(self).__name__}.{f.name}"
            if isinstance(f.default, bool) and not isinstance(value, bool):
                raise TypeError(f"{name} must be True or False; got {value!r}.")
            if f.name not in self.ranged or (
                hasattr(value, "shape") and not isinstance(value, Real)
            ):
                continue
            limits = {key: f.metadata[key] for key in ("low", "high", "unit")}
            if isinstance(value, (tuple, list)):
                if len(value) != 2:
                    raise ValueError(
                        f"{name} must be a number or a (low, high) pair; got {len(value)} values: "
                        f"{value!r}."
                    )
                low, high = (check_number(name, v, **limits, allowed=RANGE) for v in value)
                if low > high:
                    raise ValueError(
                        f"{name} must be a (low, high) pair with low <= high; got {value!r}."
                    )
                value = low if low == high else (low, high)
            else:
                value = check_number(name, value, **limits, allowed=RANGE)
            object.__setattr__(self, f.name, value)


def bounds(value: Range) -> tuple[float, float]:
    """Return `(low, high)` of a range; a plain number is a range of zero width."""
    return value if isinstance(value, tuple) else (value, value)


def deviation(value: Range, identity: float) -> float:
    """Return how far a range extends from an effect's identity."""
    return max(abs(v - identity) for v in bounds(value))


def varies(value: Range, identity: float = 0.0) -> bool:
    """Whether a range leaves an effect's identity at all."""
    return deviation(value, identity) > 0


def stated_from(part: Part, field: str) -> float:
    """Return the least number that states a field, see `ranged`."""
    return part.__dataclass_fields__[field].metadata["stated_from"]


def check_off_or_on(part: Part, field: str, off: str) -> None:
    """Refuse a range that mixes 0, which alone means `off`, with numbers that state the field:
    ValueError."""
    value, least = getattr(part, field), stated_from(part, field)
    if hasattr(value, "shape"):
        return
    low, high = bounds(value)
    if high == 0 or (low > 0 and low >= least):
        return
    allowed = f"at least {least:g}" if least else "above 0"
    raise ValueError(
        f"{type(part).__name__}.{field} must be {allowed}, or 0 alone for {off}; got {value!r}. "
        "For photos with it and without, pass a list of scenes."
    )


def check_stated_once(part: Part, field: str, other: str) -> None:
    """Check a field of which 0 means that the field `other`, 1 by default, is read instead."""
    value, given, least = getattr(part, field), getattr(part, other), stated_from(part, field)
    if hasattr(value, "shape") or hasattr(given, "shape"):
        return
    (low, high), kind = bounds(value), type(part).__name__
    if high and low < least:
        raise ValueError(
            f"{kind}.{field} must be at least {least:g}, or 0 to read {kind}.{other} instead; got "
            f"{value!r}."
        )
    if high and given != 1.0:
        raise ValueError(
            f"{kind}.{field} and {kind}.{other} say the same thing in two ways; got {value!r} and "
            f"{given!r}. Leave one out: {kind}.{other} = 1, or {kind}.{field} = 0."
        )
