"""The command line of a command without recipes: key=value, checked against its settings."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator, Sequence
from typing import Any, TypeVar

import yaml
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from moireaug.common.argument_checks import one_of
from training.config.compose import help_text
from training.config.settings import check, settings_of
from training.system.messages import is_expected, prepare_output, sentence

Schema = TypeVar("Schema")


def parse(
    argv: Sequence[str], schema: type[Schema], example: str, description: str | None
) -> Schema:
    """Return the settings of a command line; --help prints them and ends the command.

    Args:
        argv: arguments of the form key=value.
        schema: dataclass of the settings. A key that is a Python keyword has an underscore
            appended there: in_ is in=.
        example: a valid command, for the error messages.
        description: text on the command, for --help.

    Raises:
        SystemExit: 0 after --help.
        ValueError: an unknown key, with the closest known one, a missing key, or a value of
            another type or out of its bounds.
    """
    prepare_output()
    cfg = OmegaConf.structured(schema)
    fields = {str(field).removesuffix("_"): str(field) for field in cfg}
    if {"-h", "--help"} & set(argv):
        print(help_text(description, schema, {}))
        raise SystemExit(0)
    declared = settings_of(schema)
    for argument in argv:
        key, equals, value = argument.partition("=")
        one_of("a setting", key, fields)
        if not equals:
            raise ValueError(f"a setting is given as {key}=VALUE; got {argument!r}.")
        try:
            is_any = declared[key].type is Any  # of words, numbers and lists
            given = yaml.safe_load(value) if is_any else os.path.expanduser(value)
            cfg[fields[key]] = None if value == "null" else given
        except (OmegaConfBaseException, yaml.YAMLError) as error:
            raise ValueError(f"{key}: {str(error).splitlines()[0]}.") from error
    missing = OmegaConf.missing_keys(cfg)
    absent = sorted(key for key, field in fields.items() if field in missing)
    if absent:
        raise ValueError(f"{', '.join(absent)} must be given, as in: {example}")
    if not argv:
        raise ValueError(f"no settings given, as in: {example}")
    try:
        settings: Schema = OmegaConf.to_object(cfg)  # type: ignore[assignment]
    except OmegaConfBaseException as error:  # ${...}
        raise ValueError(str(error).splitlines()[0]) from error
    check(settings)
    return settings


@contextlib.contextmanager
def report_errors(interruption: str) -> Iterator[None]:
    """Report an error as one sentence and end the command.

    Args:
        interruption: message after Ctrl-C, on the work that survives it.

    Raises:
        SystemExit: 130 after an interruption, 1 after an error.
    """
    try:
        yield
    except KeyboardInterrupt:
        print(f"\n{interruption}", file=sys.stderr)
        raise SystemExit(130) from None
    except (ValueError, TypeError, OSError, RuntimeError) as error:
        if not is_expected(error):
            raise
        raise SystemExit(f"error: {sentence(error)}") from None
