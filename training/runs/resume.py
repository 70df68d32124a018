"""Whether a run in its folder can be resumed or reused, and the reasons against it."""

from collections.abc import Iterator
from typing import Any

from training.config.schema import Config
from training.runs.identity import Origin
from training.runs.layout import BEST, LAST, METRICS, SETTINGS
from training.runs.metrics import RunMetrics
from training.runs.run import Run
from training.runs.trained import read, stored_class_names
from training.system.files import read_checkpoint


def require_resumable(run: Run[Any], *others: Run[Any] | None) -> None:
    """Refuse `resume=true` where neither this run nor any of the others can be resumed."""
    path = run.folder
    if run.can_resume():
        return
    for other in others:
        if other and other.can_resume() and not (other.folder / METRICS).is_file():
            return
    if run.stage() == "other":
        raise ValueError(
            f"resume=true, but {path} was made with other settings, see {path / SETTINGS}: "
            "pass those, or leave resume=true out, and that run is moved aside."
        )
    raise ValueError(
        f"resume=true needs {path / LAST}, which does not exist: leave it out to start."
    )


def require_same_origin(run: Run[Any], origin: Origin) -> None:
    """Refuse to resume a run on other data than it was trained on, whose training images would
    validate or test it, or whose classes change their meaning; or with other first weights."""
    if difference := origin_difference(run, origin):
        advice = "Restore them (another image may stand in for a damaged file)"
        if difference == _weights_difference(run):
            advice = "Restore that file"
        raise ValueError(
            f"the run in {run.folder} cannot go on: {difference}. {advice}, or pass resume=false, "
            "which moves that run aside and trains again."
        )


def damage(run: Run[Config]) -> str | None:
    """Return the damage to the files of a run that would be reused or resumed; None if they are
    whole, or if there are none."""
    folder, stage = run.folder, run.stage()
    if stage == "new" or (stage == "other" and not (folder / BEST).is_file()):
        return None
    try:
        read(folder)
        RunMetrics.read(folder)
        if stage == "begun":
            read_checkpoint(folder / LAST)
    except ValueError as error:
        return str(error).split(". ")[0].rstrip(".")
    return None


def origin_difference(run: Run[Any], origin: Origin) -> str | None:
    """Return how the data or the first weights differ from those that the run in the folder was
    trained on, as a clause; None where they do not, are not known, or where there is no such run.
    """
    for checkpoint in _checkpoints(run):
        if origin.weights and checkpoint.get("weights") != origin.weights:
            return _weights_difference(run)
        classes = stored_class_names(checkpoint.get("classes"))
        if origin.classes and classes not in (None, origin.classes):
            return "it was trained on other classes"
        if origin.files is not None and checkpoint.get("files") not in (None, origin.files):
            return "the files that it was trained on are not those that are there now"
    return None


def _weights_difference(run: Run[Any]) -> str:
    return f"{run.config.weights} no longer holds the weights that it began with"


def _checkpoints(run: Run[Any]) -> Iterator[dict[str, Any]]:
    """Yield the checkpoints of a run in its folder that are still needed: the last one only until
    its training is complete."""
    stage = run.stage()
    if stage not in ("begun", "trained", "finished"):
        return
    for name in (BEST, LAST) if stage == "begun" else (BEST,):
        path = run.folder / name
        if path.is_file():
            yield read_checkpoint(path)
