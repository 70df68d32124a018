"""Commands that Hydra runs, and sweeps of them: an error is one sentence on a line of its own, and
a sweep lists its failed jobs."""

import contextlib
import os
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import torch
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode

from training.config.command_line import HELP_FLAGS, SWEEP_FLAGS, quote_paths, why_refused
from training.config.compose import HELP_TEXTS
from training.config.recipes import require_recipe
from training.config.schema import Config, RunConfig
from training.system import machine
from training.system.files import make_folder
from training.system.messages import (
    LineStream,
    is_expected,
    prepare_output,
    print_error,
    print_traceback,
    sentence,
    status_of,
)
from training.system.processes import is_first, print_once

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
    overrides.sort(key=lambda argument: argument not in SWEEP_FLAGS)
    _command_line[:] = [script, *words, *overrides]
    sys.argv = [script, *overrides]
    asked_for = os.environ.get("HYDRA_FULL_ERROR")
    os.environ["HYDRA_FULL_ERROR"] = "1"  # raise errors, do not print them
    try:
        if HELP_FLAGS & set(overrides):  # without half a second of Hydra
            print(HELP_TEXTS[schema], flush=True)
            return
        if SWEEP_FLAGS & set(overrides):  # Hydra writes into this folder before any job
            make_folder(_folder_of_runs(overrides, schema))
        main()
    except HydraException as error:
        print_traceback()
        raise SystemExit(f"error: {why_refused(error, schema)}") from None
    except ValueError as error:  # of that folder and Hydra's own flags: a job reports its own
        print_traceback()
        raise SystemExit(f"error: {error}") from None
    except BrokenPipeError:  # the reader of --help has seen enough
        # for what is flushed at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(1) from None
    finally:
        _command_line.clear()
        del os.environ["HYDRA_FULL_ERROR"]
        if asked_for is not None:
            os.environ["HYDRA_FULL_ERROR"] = asked_for
    if _failed_jobs:
        heading = f"error: {len(_failed_jobs)} of the sweep's jobs failed:"
        print_error("\n  ".join([heading, *_failed_jobs]))
        raise SystemExit(1)


def _folder_of_runs(overrides: Sequence[str], schema: type[RunConfig]) -> Path:
    """Return the folder of `runs=`, the last one given, or its default, also of a sweep over
    several."""
    folder = schema.runs
    for override in overrides:
        if override.startswith("runs="):
            value = override.removeprefix("runs=")
            folder = value.strip("'\"")
            if "," in value and value == folder:
                folder = schema.runs
    return Path(folder)


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
        if is_expected(error):
            print_traceback()
        elif job is None:
            raise
        else:
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
