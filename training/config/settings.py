"""How a setting is declared: once, with its default and everything that is known of it; all else is
derived from the table of these."""

import dataclasses
import functools
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, is_dataclass, replace
from keyword import iskeyword
from numbers import Real
from operator import attrgetter
from types import MappingProxyType
from typing import Any, TypeVar, get_type_hints

from omegaconf import MISSING

from moireaug.common.argument_checks import one_of

Schema = TypeVar("Schema")


@dataclass(frozen=True)
class Setting:
    """A declared setting.

    Args:
        bounds: least and greatest number; None is no bound.
        choices: allowed words; empty for any.
        example: a value on a command line, for the error messages of a list or a mapping.
        is_path: whether it is a file or a folder: taken literally on a command line, and absolute
            in a run's settings. An identifier in place of a path of weights is a name of weights.
        only_for: data sets, adversary.kind, train.target or "natural", for photographed images,
            that it has an effect on; empty for all.
        changes_result: whether a run's result depends on it, so that a run with another value is
            another run. Compared runs may differ in the others, and a run's own say nothing to an
            attack on it.
        may_differ: whether compared runs may differ in it all the same.
        trains: whether it is a setting of training, which an attack on a trained model refuses.
        tests: whether it is a setting of the attack or test of a trained model alone: a run with
            another value is tested again, and not trained again.
        from_run: whether an attack on a run takes it from the run's folder, which may be a
            stranger's; else from the command line alone.
        run_has: the run's counterpart, as a noun; a setting that has one does not go with `run=`.
        key, type, default: key on a command line, such as "train.lr", type of its values, and
            value where none is given; `settings_of` reads them off the dataclass.
    """

    help: str
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
    key: str = ""
    type: Any = None
    default: Any = None


def setting(default: Any, help: str, **properties: Any) -> Any:
    """Declare a setting: the field of a dataclass.

    Args:
        default: default value, or a function that makes one for each instance.
        help, properties: fields of `Setting`.
    """
    metadata = {"setting": Setting(help, **properties)}
    if callable(default):
        return field(default_factory=default, metadata=metadata)
    return field(default=default, metadata=metadata)


def section(schema: Callable[[], Any], **properties: Any) -> Any:
    """Declare settings that share a prefix: those of a dataclass.

    Args:
        properties: fields of `Setting` that all of these settings have.
    """
    return field(default_factory=schema, metadata={"section": properties})


def settings_of(schema: Any) -> Mapping[str, Setting]:
    """Return the settings of a dataclass and of its sections, by their keys on a command line.

    A field that is named after a keyword of Python with an underscore loses it: in_ is in=."""
    return _declared_settings(schema)


@functools.cache  # not above: mypy takes the type of a dataclass for unhashable
def _declared_settings(schema: Any) -> Mapping[str, Setting]:
    settings: dict[str, Setting] = {}
    types = get_type_hints(schema)
    for one in dataclasses.fields(schema):
        key = one.name.removesuffix("_")
        if is_dataclass(one.default_factory):
            for inner in settings_of(one.default_factory).values():
                inner_key = f"{key}.{inner.key}"
                settings[inner_key] = replace(inner, key=inner_key, **one.metadata["section"])
            continue
        default = one.default
        if one.default_factory is not dataclasses.MISSING:
            default = one.default_factory()
        declared: Setting = one.metadata["setting"]
        settings[key] = replace(declared, key=key, type=types[one.name], default=default)
    return MappingProxyType(settings)


def field_of(key: str) -> str:
    """Return the dataclass's field of a key: in_ of in."""
    return f"{key}_" if iskeyword(key) else key


def value_of(cfg: Any, key: str) -> Any:
    """Return the value of a setting in a configuration."""
    return attrgetter(field_of(key))(cfg)


def with_values(cfg: Schema, values: Mapping[str, Any]) -> Schema:
    """Return a copy of a configuration with other values, by key."""
    for key, value in values.items():
        name, _, inner_key = key.partition(".")
        if inner_key:
            value = with_values(getattr(cfg, name), {inner_key: value})
        cfg = replace(cfg, **{name: value})  # type: ignore[type-var]
    return cfg


def require_declared(cfg: Any, prefix: str = "") -> None:
    """Refuse settings that a command line has added with Hydra's +key=: nothing would read them."""
    declared = {one.name: getattr(cfg, one.name) for one in dataclasses.fields(cfg)}
    for name in vars(cfg):
        one_of(f"a key in {prefix + name!r}", name, declared)
    for name, value in declared.items():
        if is_dataclass(value):
            require_declared(value, f"{prefix}{name}.")


def check(cfg: Any) -> None:
    """Refuse numbers out of their bounds, and words that are none of the choices.

    A null is not checked: the types say where it is allowed."""
    for key, one in settings_of(type(cfg)).items():
        value = value_of(cfg, key)
        if value is None:
            continue
        if one.bounds:
            _check_number(key, value, *one.bounds)
        if one.choices:
            one_of(key, str(value), one.choices)


def _check_number(key: str, value: Any, low: float, high: float | None) -> None:
    is_number = isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)
    if not is_number or value < low or (high is not None and value > high):
        allowed = f"at least {low}" if high is None else f"in [{low}, {high}]"
        raise ValueError(f"{key} must be {allowed}; got {value}.")


def with_absolute_paths(cfg: Schema) -> Schema:
    """Return the settings with absolute paths, so that runs of two projects that share a folder of
    runs are not taken for each other."""
    absolute: dict[str, Any] = {}
    for key, one in settings_of(type(cfg)).items():
        path = value_of(cfg, key)
        if not (one.is_path and one.changes_result and path):
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
