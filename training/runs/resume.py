"""Whether a run in its folder can be resumed or reused, and the reasons against it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from training.config.schema import Config
from training.runs.metrics import RunMetrics
from training.runs.run import Run
from training.runs.trained import read, stored_class_names
from training.system.files import digest, read_checkpoint

RESTORE_ADVICE = "Restore them (another image may stand in for a damaged file)"


def require_resumable(run: Run[Any], *others: Run[Any] | None) -> None:
    """Refuse `resume=true` where neither this run nor any of the others can be resumed.

    Raises:
        ValueError: there is no such run, or it was made with other settings.
    """
    path = run.folder
    if run.can_resume():
        return
    for other in others:
        if other and other.can_resume() and not (other.folder / "metrics.json").is_file():
            return
    if run.stage() == "other":
        raise ValueError(
            f"resume=true, but {path} was made with other settings, see {path / 'config.yaml'}: "
            "pass those, or leave resume=true out, and that run is moved aside."
        )
    raise ValueError(
        f"resume=true needs {path / 'last.ckpt'}, which does not exist: leave it out to start."
    )


def require_same_weights(run: Run[Config]) -> None:
    """Refuse to resume a run that began with other weights than `weights=` holds now.

    Raises:
        ValueError: says how to go on.
    """
    _refuse(weights_difference(run), run, "Restore that file")


def require_same_data(run: Run[Any], files: str, classes: Mapping[int, str] | None = None) -> None:
    """Refuse to resume a run on other data than it was trained on: its training images would
    validate or test it, or its classes change their meaning.

    Raises:
        ValueError: names the difference.
    """
    _refuse(data_difference(run, files, classes), run, RESTORE_ADVICE)


def _refuse(difference: str | None, run: Run[Any], advice: str) -> None:
    if difference:
        raise ValueError(
            f"the run in {run.folder} cannot go on: {difference}. {advice}, or pass resume=false, "
            "which moves that run aside and trains again."
        )


def damage(run: Run[Config]) -> str | None:
    """Return the damage to the files of a run that would be reused or resumed; None if they are
    whole, or if there are none."""
    folder, stage = run.folder, run.stage()
    if stage == "new" or (stage == "other" and not (folder / "best.ckpt").is_file()):
        return None
    try:
        read(folder)
        RunMetrics.read(folder)
        if stage == "begun":
            read_checkpoint(folder / "last.ckpt")
    except ValueError as error:
        return str(error).split(". ")[0].rstrip(".")
    return None


def data_difference(
    run: Run[Any], files: str, classes: Mapping[int, str] | None = None
) -> str | None:
    """Return how the data differ from those that the run in the folder was trained on, as a clause;
    None where they do not, or where there is no such run.

    Args:
        files: fingerprint of the files.
        classes: name of each class of a classifier's data.
    """
    for checkpoint in _checkpoints(run):
        if classes and stored_class_names(checkpoint.get("classes")) not in (None, classes):
            return "it was trained on other classes"
        if checkpoint.get("files") not in (None, files):
            return "the files that it was trained on are not those that are there now"
    return None


def weights_difference(run: Run[Config]) -> str | None:
    """Return how the file of `weights=` differs from the weights that the run in the folder began
    with, as a clause; None where it does not, or where there is no such run or file."""
    weights = run.config.weights
    if weights is None or not Path(weights).is_file():
        return None
    current = digest(weights)
    for checkpoint in _checkpoints(run):
        if checkpoint.get("weights") not in (None, current):
            return f"{weights} no longer holds the weights that it began with"
    return None


def _checkpoints(run: Run[Any]) -> Iterator[dict[str, Any]]:
    """Yield the checkpoints of a run in its folder that are still needed: the last one only until
    its training is complete."""
    stage = run.stage()
    if stage not in ("begun", "trained", "finished"):
        return
    for name in ("best.ckpt", "last.ckpt") if stage == "begun" else ("best.ckpt",):
        path = run.folder / name
        if path.is_file():
            yield read_checkpoint(path)
