"""Whether what a run's folder holds can be reused or resumed, and what stands against it."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from training.config.overrides import command_line
from training.config.schema import Config
from training.data.splits import Splits
from training.runs.run import Run, baseline_of, result_settings
from training.runs.trained import TrainedRun, class_names, read
from training.system.files import digest, read_checkpoint, read_metrics
from training.system.processes import is_first

Metrics = dict[str, Any]
RESTORE = "Restore them (another image may stand in for a damaged file)"


def require_resumable(run: Run[Any], *others: Run[Any] | None) -> None:
    """Refuse `resume=true` where neither this run nor any of the others can be resumed.

    Raises:
        ValueError: there is no such run, or it was made with other settings.
    """
    for own in (run, *others):
        if own and own.can_resume():
            return
    path = run.folder
    if run.stage() == "other":
        raise ValueError(
            f"resume=true, but {path} was made with other settings, see {path / 'config.yaml'}: "
            "pass those, or leave resume=true out, and that run is moved aside."
        )
    raise ValueError(
        f"resume=true needs {path / 'last.ckpt'}, which does not exist: leave it out to start."
    )


def require_same_weights(run: Run[Config]) -> None:
    """Refuse to go on with a run that began with other weights than `weights=` holds now.

    Raises:
        ValueError: with what to do.
    """
    _refuse(other_weights(run), run, "Restore that file")


def require_same_data(run: Run[Config], splits: Splits) -> None:
    """Refuse to go on with a run on other data than it was trained on: images that it was trained
    on would validate it, or classes change their meaning.

    Raises:
        ValueError: with what differs.
    """
    _refuse(other_data(run, splits), run, RESTORE)


def _refuse(difference: str | None, run: Run[Config], advice: str) -> None:
    if difference:
        raise ValueError(
            f"the run in {run.folder} cannot go on: {difference}. {advice}, or pass resume=false, "
            "which moves that run aside and trains again."
        )


def is_unreported(run: Run[Config]) -> bool:
    """Return whether a run was trained as the start or baseline of another, and not attacked."""
    known = metrics_of_trained(run)
    return known is not None and "reattack" not in known


def metrics_of_trained(run: Run[Config]) -> Metrics | None:
    """Return the metrics of a run that was trained with these settings; None for no such run. How
    it was attacked may differ."""
    known = read_metrics(run.folder)
    if not known or not (run.folder / "best.ckpt").is_file():
        return None
    return known if _same_training(known.get("config") or {}, run.settings) else None


def same_training(one: Config, other: Config) -> bool:
    """Return whether two runs are the same but for how they are attacked again."""
    return _same_training(result_settings(one), result_settings(other))


def _same_training(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    unattacked = {"reattack": None}
    return {**one, **unattacked} == {**other, **unattacked}


def damage(run: Run[Config]) -> str | None:
    """Return what is wrong with the files of a run that would be reused or resumed.

    None if they are whole, or if there are none.
    """
    folder, stage = run.folder, run.stage()
    if stage == "new" or (stage == "other" and not (folder / "best.ckpt").is_file()):
        return None
    try:
        read(folder)
        if stage == "begun":
            read_checkpoint(folder / "last.ckpt")
    except ValueError as error:
        return str(error).split(". ")[0].rstrip(".")
    return None


def other_data(run: Run[Config], splits: Splits) -> str | None:
    """Return in what the data that a run in its folder was trained on differ from these.

    None where they do not, or where there is no such run.
    """
    for checkpoint in _checkpoints(run):
        if class_names(checkpoint.get("classes")) not in (None, splits.classes):
            return "it was trained on other classes"
        if checkpoint.get("files") not in (None, splits.files):
            return "the files that it was trained on are not those that are there now"
    return None


def other_weights(run: Run[Config]) -> str | None:
    """Return that a run in its folder began with other weights than the file of `weights=` holds
    now.

    None where it did not, or where there is no such run or file.
    """
    weights = run.config.weights
    if weights is None or not Path(weights).is_file():
        return None
    now = digest(weights)
    for checkpoint in _checkpoints(run):
        if checkpoint.get("weights") not in (None, now):
            return f"{weights} no longer holds the weights that it began with"
    return None


def _checkpoints(run: Run[Config]) -> Iterator[dict[str, Any]]:
    """Yield the checkpoints of a run in its folder."""
    for name in ("best.ckpt", "last.ckpt"):
        if run.stage() in ("begun", "trained", "finished") and (run.folder / name).is_file():
            yield read_checkpoint(run.folder / name)


def trained_run(run: Run[Config]) -> TrainedRun:
    """Read a run that was trained; how it was attacked may differ.

    Raises:
        ValueError: as `read`; or another command has replaced it.
    """
    present = read(run.folder)
    # in another process of this run, the first may still be writing the metrics
    whole = not is_first() or read_metrics(present.folder) is not None
    if whole and same_training(present.cfg, run.config):
        return present
    raise ValueError(
        f"{present.folder} no longer holds the run that was trained there for this one: another "
        "command has replaced it. Run this command again, and one of the two with another "
        "runs=DIR."
    )


def baseline_beside(run: TrainedRun) -> TrainedRun | None:
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
        present = read(folder)
    except ValueError as error:
        there = replace(wanted, runs=str(folder.parent.parent))
        command = shlex.join(["python", "training/fit.py", *command_line(there), "resume=false"])
        print(
            f"note: no baseline is attacked beside this run. {error}\n"
            f"This trains it again:\n  {command}"
        )
        return None
    if not same_training(present.cfg, wanted):
        print(
            f"note: {folder} was trained with other settings: "
            "no baseline is attacked beside this run."
        )
        return None
    return present
