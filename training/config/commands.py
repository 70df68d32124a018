"""How every command reads its settings and reports an error: one sentence on its own line; a sweep
lists its failed jobs."""

import contextlib
import os
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

import torch
import yaml
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from moireaug.common.argument_checks import one_of
from training.config.command_line import (
    HELP_FLAGS,
    SWEEP_FLAGS,
    quote_paths,
    why_refused,
)
from training.config.compose import HELP_TEXTS, help_text
from training.config.recipes import require_recipe
from training.config.schema import Config, RunConfig, as_config
from training.config.settings import check, field_of, settings_of
from training.system import machine
from training.system.files import make_folder
from training.system.messages import (
    LineStream,
    is_expected,
    prepare_output,
    print_error,
    sentence,
    status_of,
)
from training.system.processes import is_first, print_once

Schema = TypeVar("Schema")
_failed_jobs: list[str] = []  # jobs of a sweep
_command_line: list[str] = []  # the command line, whole: Hydra is not shown its first words


def run(
    main: Callable[[], None], schema: type[RunConfig], arguments: Sequence[str] | None = None
) -> None:
    """Run a Hydra command, or its sweep.

    Args:
        arguments: settings at the end of the command line; None: all of it.

    Raises:
        SystemExit: a wrong command line, or jobs of a sweep that failed, with a list of them.
    """
    prepare_output()
    sys.stdout, sys.stderr = LineStream(sys.stdout), LineStream(sys.stderr)
    script, *words = sys.argv
    if arguments is None:
        arguments, words = words, []
    else:
        words = words[: len(words) - len(arguments)]
    overrides = quote_paths(arguments, schema)
    if schema is Config:
        require_recipe(overrides)
    # to the front: Hydra takes no settings after such a flag
    overrides = sorted(overrides, key=lambda argument: argument not in SWEEP_FLAGS)
    _command_line[:] = [script, *words, *overrides]
    sys.argv = [script, *overrides]
    os.environ["HYDRA_FULL_ERROR"] = "1"  # raise errors, do not print them
    folders = [a.removeprefix("runs=").strip("'\"") for a in overrides if a.startswith("runs=")]
    try:
        if HELP_FLAGS & set(overrides):  # without half a second of Hydra
            print(HELP_TEXTS[schema], flush=True)
            return
        if SWEEP_FLAGS & set(overrides):  # Hydra writes into this folder before any job
            make_folder(Path(folders[-1] if folders else schema.runs))
        main()
    except HydraException as error:
        raise SystemExit(f"error: {why_refused(error, schema)}") from None
    except ValueError as error:  # of that folder and Hydra's own flags: a job reports its own
        raise SystemExit(f"error: {error}") from None
    except BrokenPipeError:  # the reader of --help has seen enough
        # for what is flushed at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(1) from None
    finally:
        _command_line.clear()
    if _failed_jobs:
        heading = f"error: {len(_failed_jobs)} of the sweep's jobs failed:"
        print_error("\n  ".join([heading, *_failed_jobs]))
        raise SystemExit(1)


@contextlib.contextmanager
def report_job_errors(kept_work: str) -> Iterator[None]:
    """Report an error in a job as one sentence and end the command; a sweep continues.

    Args:
        kept_work: clause on the work that survives an interruption, such as "Every complete epoch
            is kept".

    Raises:
        SystemExit: 130 after Ctrl-C, 143 after SIGTERM, 1 after an error.
    """
    if _command_line:
        sys.argv = list(_command_line)
    try:
        yield
    except KeyboardInterrupt as interruption:
        command = machine.command([a for a in sys.argv if not a.startswith("resume=")])
        print_once(f"\nInterrupted. {kept_work}; the same command continues:\n  {command}")
        raise SystemExit(status_of(interruption)) from None
    except Exception as error:
        job = _job_of_a_sweep()
        if not is_expected(error):
            if job is None:
                raise
            print_error(traceback.format_exc())
        if not isinstance(error, ConnectionError) or is_first():  # the first process speaks for all
            print_error(f"error: {sentence(error)}")
        # the processes of this run are not started again for the next job
        if job is None or torch.distributed.is_initialized():
            raise SystemExit(1) from None
        _failed_jobs.append(f"{job}: {sentence(error).splitlines()[0]}")


def _job_of_a_sweep() -> str | None:
    """Return the overrides of this job; None outside of a sweep."""
    hydra = HydraConfig.get()
    return " ".join(hydra.overrides.task) if hydra.mode == RunMode.MULTIRUN else None


def parse(
    argv: Sequence[str], schema: type[Schema], example: str, description: str | None
) -> Schema:
    """Return the settings of the command line of a command without recipes, key=value each, with
    values as they are; --help prints the settings and ends the command.

    Args:
        example: a valid command, for the error messages.
    """
    prepare_output()
    if HELP_FLAGS & set(argv):
        print(help_text(description, schema, {}))
        raise SystemExit(0)
    cfg, table = OmegaConf.structured(schema), settings_of(schema)
    try:
        for argument in argv:
            key, equals, value = argument.partition("=")
            one_of("a setting", key, table)
            if not equals:
                raise ValueError(f"a setting is given as {key}=VALUE; got {argument!r}.")
            is_any = table[key].type is Any  # of words, numbers and lists
            parsed = yaml.safe_load(value) if is_any else os.path.expanduser(value)
            cfg[field_of(key)] = None if value == "null" else parsed
        missing = [key for key in sorted(table) if OmegaConf.is_missing(cfg, field_of(key))]
        if missing:
            raise ValueError(f"{', '.join(missing)} must be given, as in: {example}")
        key = "the settings"
        settings: Schema = as_config(cfg)
    except OmegaConfBaseException as error:
        raise ValueError(f"{key}: {str(error).splitlines()[0]}.") from error
    except yaml.YAMLError as error:
        raise ValueError(
            f"{argument} cannot be read: pass {key}={table[key].example}, say."
        ) from error
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
