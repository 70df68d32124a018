"""A trained run, read as data: its folder may come from anyone.

Nothing in it is run, imported or looked up, and it names no files but those of its data set.
"""

import os
from pathlib import Path
from typing import Any, NamedTuple

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from torch import Tensor, nn

from moireaug.common.argument_checks import one_of
from training.config.data_sets import DATA, Data
from training.config.recipes import RECIPE_NAME
from training.config.scenes import scene_of
from training.config.schema import Config, as_config
from training.data.splits import Splits
from training.models.classifiers import OWN_MODELS, as_model, class_count, model_names
from training.runs.layout import BEST, METRICS, SETTINGS, read_metrics, run_folder
from training.runs.metrics import TrainCost
from training.runs.run import Run, baseline_of
from training.system.files import read_checkpoint, read_settings
from training.system.processes import is_first


class TrainedRun(NamedTuple):
    """A run as it was read from its folder.

    Args:
        state: its best weights.
        classes: name of each logit; None where the checkpoint has no names.
        original: weights whose answers it was to keep; None where it was trained on labels.
    """

    folder: Path
    cfg: Config
    state: dict[str, Tensor]
    classes: dict[int, str] | None
    original: dict[str, Tensor] | None = None

    @property
    def num_classes(self) -> int:
        """Return the number of logits; 0 where these are not the weights of a classifier."""
        return class_count(self.cfg.model, self.state)

    def model(self) -> nn.Module:
        """Return the run's best model, in evaluation mode."""
        return self._model(self.state)

    def original_model(self) -> nn.Module | None:
        """Return the model whose answers the run was to keep, in evaluation mode; None where it was
        trained on labels."""
        return None if self.original is None else self._model(self.original)

    def _model(self, state: dict[str, Tensor]) -> nn.Module:
        model = as_model(self.cfg.model, self.num_classes, None)
        try:
            model.load_state_dict(state)
        except RuntimeError as error:
            path = self.folder / BEST
            raise ValueError(
                f"{path} does not fit {self.cfg.model} with {self.num_classes} classes: {error}"
            ) from error
        return model.eval()

    def check_classes(self, splits: Splits, data: Data) -> None:
        """Refuse data whose classes are not the run's: every answer would count as wrong."""
        hint = (
            "Pass data whose class folders are those that the run was trained on, or another run."
        )
        if splits.num_classes != self.num_classes:
            raise ValueError(
                f"{self.folder} was trained on {self.num_classes} classes, and the data "
                f"{data.name} has {splits.num_classes}. {hint}"
            )
        # any of the 1000 published classes will do
        among_published = self.cfg.data.class_index and data.class_index
        if self.classes is None or among_published or self.classes == splits.classes:
            return
        odd = min(set(self.classes.items()) ^ set(splits.classes.items()))[0]
        ours, theirs = self.classes.get(odd), splits.classes.get(odd)
        raise ValueError(
            f"class {odd} of {self.folder} is {ours!r}, and {theirs!r} in the data {data.name}. "
            f"{hint}"
        )


def read(folder: Path) -> TrainedRun:
    """Read a run's settings and best weights."""
    config, best = folder / SETTINGS, folder / BEST
    if not config.is_file() or not best.is_file():
        raise ValueError(
            f"{folder} is not a run's folder: it must hold {SETTINGS} and {BEST}, as fit.py "
            "writes them."
        )
    # The checkpoint first: a command that replaces a run writes the settings first, so weights of
    # another run are never taken for those of these settings.
    checkpoint = read_checkpoint(best)
    cfg = read_config(config)
    state = {name.removeprefix("model."): value for name, value in checkpoint["state_dict"].items()}
    classes = stored_class_names(checkpoint.get("classes"))
    trained = TrainedRun(folder, cfg, state, classes, checkpoint.get("original"))
    if trained.num_classes < 1:
        raise ValueError(f"{best} holds no classifier's weights. Name another run.")
    return trained


def read_config(path: Path) -> Config:
    """Read a run's settings: known keys with values of their types, none looked up elsewhere."""
    values = read_settings(path)
    try:
        cfg = OmegaConf.merge(OmegaConf.structured(Config), values)
        for key in sorted(OmegaConf.missing_keys(cfg)):
            raise ValueError(f"{key} is missing")
        if not RECIPE_NAME.fullmatch(cfg.recipe):
            raise ValueError(f"recipe must be a name; got {cfg.recipe!r}.")
        one_of("data.name", cfg.data.name, DATA)
        if cfg.model not in OWN_MODELS:
            one_of("model", cfg.model, model_names())
        config: Config = as_config(cfg)
        scene_of(config)
    except (OmegaConfBaseException, ValueError, TypeError, OverflowError) as error:
        reason = str(error).splitlines()[0].rstrip(".")
        raise ValueError(
            f"{path} is not a run's settings: {reason}. A run holds the settings of "
            "training/fit.py alone, as this version writes them."
        ) from None
    config.data.download = False  # that a folder asks for: only a command line may
    return config


def read_training_cost(folder: Path) -> TrainCost | None:
    """Read the cost of a run's training; None where it is missing or damaged."""
    try:
        return TrainCost.read(folder)
    except ValueError:
        return None


def stored_class_names(stored: Any) -> dict[int, str] | None:
    """Return the names of the classes that are stored in a checkpoint; None where it has none."""
    if not isinstance(stored, dict):
        return None
    return {int(number): str(name) for number, name in stored.items()}


def read_trained(run: Run[Config]) -> TrainedRun:
    """Read the trained run in the folder; the settings of its re-attack may differ."""
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

    None where there is none; a note says why if its folder is there."""
    baseline = baseline_of(Run(run.cfg))
    if baseline is None:
        return None
    wanted = baseline.config
    group = Path(os.path.abspath(run.folder)).parent.parent
    folder = run_folder(group, wanted.recipe, wanted.seed)
    if not (folder / METRICS).is_file():
        return None
    try:
        baseline_run = read(folder)
    except ValueError as error:
        print(
            f"note: no baseline is attacked beside this run. {error} Recipe {wanted.recipe} with "
            "the run's other settings and resume=false trains it again."
        )
        return None
    if Run(baseline_run.cfg).training_fingerprint != baseline.training_fingerprint:
        print(
            f"note: {folder} was trained with other settings: "
            "no baseline is attacked beside this run."
        )
        return None
    return baseline_run
