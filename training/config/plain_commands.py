"""Commands with settings alone, key=value each, read without Hydra: a value is taken as it is, and
an error is one sentence."""

import contextlib
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeVar

import yaml
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from moireaug.common.argument_checks import one_of
from training.config.command_line import HELP_FLAGS
from training.config.compose import help_text
from training.config.schema import as_config
from training.config.settings import Setting, check, field_of, settings_of
from training.system.messages import is_expected, prepare_output, print_traceback, sentence

Schema = TypeVar("Schema")


def parse(
    argv: Sequence[str], schema: type[Schema], example: str, description: str | None
) -> Schema:
    """Return the settings of a command line; --help prints them and ends the command.

    Args:
        example: a valid command, for the error messages.
    """
    prepare_output()
    if HELP_FLAGS & set(argv):
        print(help_text(description, schema, {}))
        raise SystemExit(0)
    cfg, table = OmegaConf.structured(schema), settings_of(schema)
    for argument in argv:
        _set(cfg, table, argument)
    missing = [key for key in sorted(table) if OmegaConf.is_missing(cfg, field_of(key))]
    if missing:
        raise ValueError(f"{', '.join(missing)} must be given, as in: {example}")
    settings: Schema = as_config(cfg)
    check(settings)
    return settings


def _set(cfg: Any, table: Mapping[str, Setting], argument: str) -> None:
    """Give a setting the value that an argument has for it."""
    key, _, value = argument.partition("=")
    one_of("a setting", key, table)
    if not value:  # also of a shell's variable that is not set
        raise ValueError(f"a setting is given as {key}=VALUE; got {argument!r}.")
    try:
        if value == "null":
            cfg[field_of(key)] = None
        elif table[key].type is Any:  # of words, numbers and lists
            cfg[field_of(key)] = yaml.safe_load(value)
        else:
            cfg[field_of(key)] = os.path.expanduser(value)
    except OmegaConfBaseException as error:
        raise ValueError(f"{key}: {str(error).splitlines()[0]}.") from error
    except yaml.YAMLError as error:
        raise ValueError(
            f"{argument} cannot be read: pass {key}={table[key].example}, say."
        ) from error


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
    except Exception as error:
        if not is_expected(error):
            raise
        print_traceback()
        raise SystemExit(f"error: {sentence(error)}") from None
