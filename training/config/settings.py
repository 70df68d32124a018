"""How a setting is declared: once, with its default and everything that is known of it."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, is_dataclass
from keyword import iskeyword
from numbers import Real
from operator import attrgetter
from typing import Any, NamedTuple, TypeVar, get_type_hints

from omegaconf import MISSING

from moireaug.common.argument_checks import one_of

Schema = TypeVar("Schema")


@dataclass(frozen=True)
class Facts:
    """What is known of a setting besides its name, its type and its default.

    Args:
        help: description, in a line or two.
        bounds: least and greatest number; None is no bound.
        choices: allowed words; empty for any.
        example: a value on a command line, for the error messages of a list or a mapping.
        is_path: whether it is a file or a folder: taken literally on a command line, and absolute
            in a run's settings. An identifier in place of a path of weights is a name of weights.
        only_for: data sets that it has an effect on; empty for all.
        changes_result: whether a run's result depends on it, so that a run with another value is
            another run.
        may_differ: whether compared runs may differ in it.
        trains: whether it is a setting of training, which an attack on a trained model refuses.
        tests: whether it is a setting of the attack or test of a trained model alone: a run with
            another value is tested again, and not trained again.
        from_run: whether an attack on a run takes it from the run's folder, which may be a
            stranger's; else from the command line alone.
        run_has: the run's counterpart, as a noun; a setting that has one does not go with `run=`.
    """

    help: str = ""
    bounds: tuple[float, float | None] | None = None
    choices: tuple[str, ...] = ()
    example: str = ""
    is_path: bool = False
    only_for: tuple[str, ...] = ()
    changes_result: bool = True
    may_differ: bool = False
    trains: bool = False
    tests: bool = False
    from_run: bool = True
    run_has: str = ""


def setting(default: Any, help: str, **facts: Any) -> Any:
    """Declare a setting: the field of a dataclass.

    Args:
        default: default value, or a function that makes one for each instance.
        help, facts: fields of `Facts`.
    """
    metadata = {"facts": Facts(help, **facts)}
    if callable(default):
        return field(default_factory=default, metadata=metadata)
    return field(default=default, metadata=metadata)


def section(schema: Callable[[], Any], **facts: Any) -> Any:
    """Declare settings that share a prefix: those of a dataclass.

    Args:
        schema: dataclass of the settings.
        facts: `trains`, `tests` or `from_run` of `Facts`, of all of these settings.
    """
    return field(default_factory=schema, metadata={"facts": Facts(**facts)})


class Setting(NamedTuple):
    """A declared setting.

    Args:
        key: key on a command line, such as "train.lr".
        type: type of its values.
        default: value where none is given.
        facts: its other facts.
    """

    key: str
    type: Any
    default: Any
    facts: Facts

    @property
    def is_list(self) -> bool:
        """Whether its value is a list."""
        return "list[" in str(self.type)


def settings_of(schema: Any) -> Mapping[str, Setting]:
    """Return the settings of a dataclass and of its sections, by their keys on a command line.

    A field that is named after a keyword of Python with an underscore loses it: in_ is in=.
    """
    settings: dict[str, Setting] = {}
    types = get_type_hints(schema)
    for one in dataclasses.fields(schema):
        key, facts = one.name.removesuffix("_"), one.metadata.get("facts", Facts())
        if is_dataclass(one.default_factory):
            for inner in settings_of(one.default_factory).values():
                inner_key = f"{key}.{inner.key}"
                inner_facts = dataclasses.replace(
                    inner.facts,
                    trains=facts.trains or inner.facts.trains,
                    tests=facts.tests or inner.facts.tests,
                    from_run=facts.from_run and inner.facts.from_run,
                )
                settings[inner_key] = inner._replace(key=inner_key, facts=inner_facts)
            continue
        default = one.default
        if one.default_factory is not dataclasses.MISSING:
            default = one.default_factory()
        settings[key] = Setting(key, types[one.name], default, facts)
    return settings


def value_of(cfg: Any, key: str) -> Any:
    """Return the value of a setting in a configuration."""
    fields = [f"{part}_" if iskeyword(part) else part for part in key.split(".")]
    return attrgetter(".".join(fields))(cfg)


def with_values(cfg: Schema, values: dict[str, Any]) -> Schema:
    """Return a copy of a configuration with other values, by key."""
    direct: dict[str, Any] = {}
    nested: dict[str, dict[str, Any]] = {}
    for key, value in values.items():
        name, _, inner_key = key.partition(".")
        if inner_key:
            nested.setdefault(name, {})[inner_key] = value
        else:
            direct[name] = value
    for name, inner_values in nested.items():
        direct[name] = with_values(direct.get(name, getattr(cfg, name)), inner_values)
    return dataclasses.replace(cfg, **direct)  # type: ignore[type-var]


def check(cfg: Any) -> None:
    """Refuse numbers out of their bounds, and words that are none of the choices.

    A null is not checked: the types say where it is allowed.

    Raises:
        ValueError: with what was got and what is allowed.
    """
    for key, declared in settings_of(type(cfg)).items():
        value = value_of(cfg, key)
        if value is None:
            continue
        if declared.facts.bounds:
            _check_number(key, value, *declared.facts.bounds)
        if declared.facts.choices:
            one_of(key, str(value), declared.facts.choices)


def _check_number(key: str, value: Any, low: float, high: float | None) -> None:
    allowed = f"at least {low}" if high is None else f"in [{low}, {high}]"
    is_number = isinstance(value, Real) and not isinstance(value, bool)
    if not is_number or not math.isfinite(value):
        raise ValueError(f"{key} must be {allowed}; got {value}.")
    if value < low or (high is not None and value > high):
        raise ValueError(f"{key} must be {allowed}; got {value}.")


def with_absolute_paths(cfg: Schema) -> Schema:
    """Return the settings with absolute paths, so that runs of two projects that share a folder of
    runs are not taken for each other."""
    absolute: dict[str, Any] = {}
    for key, declared in settings_of(type(cfg)).items():
        path = value_of(cfg, key)
        if not (declared.facts.is_path and declared.facts.changes_result and path):
            continue
        if key != "weights" or not path.isidentifier():  # torchvision's names of weights are
            absolute[key] = os.path.abspath(path)
    return with_values(cfg, absolute)


def as_argument(value: Any) -> str:
    """Return a value as a command line takes it; "" where one must be given."""
    if value == MISSING:
        return ""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (list, tuple)):
        return f"[{','.join(map(str, value))}]"
    return str(value)
