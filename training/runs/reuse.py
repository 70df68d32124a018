"""Trained runs that are reused: as the start or baseline of another, or beside a re-attack."""

from __future__ import annotations

import os
import shlex
from dataclasses import replace
from pathlib import Path

from training.config.command_line import command_line
from training.config.schema import Config
from training.runs.run import Run, baseline_of
from training.runs.trained import TrainedRun, read
from training.system.files import read_metrics
from training.system.processes import is_first


def read_trained(run: Run[Config]) -> TrainedRun:
    """Read the trained run in the folder; the settings of its re-attack may differ.

    Raises:
        ValueError: as `read`; or another command has replaced it.
    """
    trained = read(run.folder)
    # in another process of this run, the first may still be writing the metrics
    is_complete = not is_first() or read_metrics(trained.folder) is not None
    if is_complete and Run(trained.cfg).training_fingerprint == run.training_fingerprint:
        return trained
    raise ValueError(
        f"{trained.folder} no longer holds the run that was trained there for this one: another "
        "command has replaced it. Run this command again, and one of the two with another "
        "runs=DIR."
    )


def read_baseline_of(run: TrainedRun) -> TrainedRun | None:
    """Read the run that this one is compared with, where it is beside it with the same settings.

    None where there is none; a note says why if its folder is there.
    """
    baseline = baseline_of(Run(run.cfg))
    if baseline is None:
        return None
    wanted = baseline.config
    folder = Path(os.path.abspath(run.folder)).parent.parent / wanted.recipe / f"seed{run.cfg.seed}"
    if not (folder / "metrics.json").is_file():
        return None
    try:
        baseline_run = read(folder)
    except ValueError as error:
        wanted_there = replace(wanted, runs=str(folder.parent.parent))
        command = shlex.join(
            ["python", "training/fit.py", *command_line(wanted_there), "resume=false"]
        )
        print(
            f"note: no baseline is attacked beside this run. {error}\n"
            f"This trains it again:\n  {command}"
        )
        return None
    if Run(baseline_run.cfg).training_fingerprint != baseline.training_fingerprint:
        print(
            f"note: {folder} was trained with other settings: "
            "no baseline is attacked beside this run."
        )
        return None
    return baseline_run
