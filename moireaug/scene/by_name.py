"""Parts by their names, and the ranged fields of all five at once, by names such as "view.yaw"."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from moireaug.common.argument_checks import one_of
from moireaug.scene.parts import PARTS

R = TypeVar("R", bound=Any)
# parts and fields that a 0 leaves unstated
UNSTATED_AT_0 = tuple(
    (part, name)
    for part, kind in PARTS.items()
    for name in kind.ranged
    if kind.__dataclass_fields__[name].metadata["stated_from"] is not None
)


def values_of(record: Any) -> dict[str, Any]:
    """Return the ranged fields of a scene or a shot by name, in the order of draws."""
    found = {}
    for name in PARTS:
        part = getattr(record, name)
        for field in part.ranged:
            found[f"{name}.{field}"] = getattr(part, field)
    return found


def parts_with(record: Any, numbers: Mapping[str, Any]) -> dict[str, Any]:
    """Return the five parts of a scene or a shot, by name, with drawn numbers, (B,) each."""
    parts = {}
    for name in PARTS:
        part = getattr(record, name)
        parts[name] = part.drawn({field: numbers[f"{name}.{field}"] for field in part.ranged})
    return parts


def limits(scene: Any) -> np.ndarray:
    """Return the least and the greatest number that a shot of a scene may have of each field, in
    the order of `values_of`: (2, fields, 1) float64. 0, which leaves some fields unstated, is none
    of those that the scene states."""
    values = [getattr(getattr(scene, part), field) for part, field in UNSTATED_AT_0]
    return _limits(tuple(value != 0 for value in values))


def limits_by_name(scene: Any) -> dict[str, tuple[float, float]]:
    """Return `limits` as pairs by name."""
    return dict(zip(values_of(scene), limits(scene)[..., 0].T.tolist(), strict=True))


@functools.cache
def _limits(is_stated: tuple[bool, ...]) -> np.ndarray:
    """Return `limits` of scenes that state these fields of `UNSTATED_AT_0`. Of numpy: a cached
    tensor could belong to a fake mode of torch.compile."""
    stated = dict(zip(UNSTATED_AT_0, is_stated, strict=True))
    pairs = []
    for part, kind in PARTS.items():
        for name in kind.ranged:
            allowed = kind.__dataclass_fields__[name].metadata
            least = allowed["stated_from" if stated.get((part, name)) else "low"]
            pairs.append((least, allowed["high"]))
    return np.array(pairs, np.float64).T[..., None]


def by_part(numbers: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return numbers by part and field, as a dict of a shot holds them."""
    parts: dict[str, dict[str, Any]] = {name: {} for name in PARTS}
    for name, value in numbers.items():
        part, field = name.split(".")
        parts[part][field] = value
    return parts


def with_values(record: R, values: Mapping[str, Any]) -> R:
    """Return a scene or a shot with other values of some fields, by names such as "view.yaw"."""
    parts = {}
    for name, changed in by_part(values).items():
        if changed:
            parts[name] = replace(getattr(record, name), **changed)
    return replace(record, **parts)


def parts_from_dict(values: Mapping[str, Any], base: Mapping[str, Any]) -> dict[str, Any]:
    """Build the five parts of a scene from plain values by part; others are those of `base`."""
    for key in values:
        one_of("a key of a scene", key, (*PARTS, "tolerance", "preset"))
    parts = {}
    for name, kind in PARTS.items():
        given = {} if values.get(name) is None else values[name]
        if not isinstance(given, Mapping):
            raise TypeError(f"Scene.{name} must be a mapping of its fields; got {given!r}.")
        settings = _with_tuples(base[name] | dict(given))
        for key in settings:
            one_of(f"a field of Scene.{name}", key, sorted(kind.__dataclass_fields__))
        parts[name] = kind(**settings)
    return parts


def _with_tuples(value: Any) -> Any:
    """Return mappings and sequences of any kind, such as OmegaConf's, as dicts and tuples."""
    if isinstance(value, Mapping):
        return {key: _with_tuples(one) for key, one in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return tuple(_with_tuples(one) for one in value)
    return value
