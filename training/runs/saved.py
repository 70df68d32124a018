"""A trained run, read as data: its folder may come from anyone.

Nothing in it is run, imported or looked up, and it names no files but those of its data set.
"""

from __future__ import annotations

import math
import os
import re
import shlex
from collections.abc import Iterator, Mapping
from numbers import Real
from pathlib import Path
from typing import Any, NamedTuple

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from torch import Tensor, nn

from moireaug.scene.fields import one_of
from training.config.overrides import command_line
from training.config.schema import DATA, Config, Data, as_config, scene_of
from training.data.splits import Splits
from training.models.classifiers import OWN, as_model, names
from training.runs.folder import RunFolder, baseline_config, result_settings, run_folder
from training.system.files import digest, read_checkpoint, read_metrics, read_settings
from training.system.processes import is_first


class Saved(NamedTuple):
    """A run as it was read from its folder.

    Args:
        folder: where it is. cfg: the settings that it was trained with. state: its best weights.
        classes: the name of each logit; None where the checkpoint does not say.
    """

    folder: Path
    cfg: Config
    state: dict[str, Tensor]
    classes: dict[int, str] | None

    @property
    def num_classes(self) -> int:
        """Return the number of logits; 0 where these are not the weights of a classifier."""
        heads = [
            value for name, value in self.state.items() if name.endswith("weight") and value.dim()
        ]
        return len(heads[-1]) if heads else 0

    def model(self) -> nn.Module:
        """Return the run's best model, in evaluation mode.

        Raises:
            ValueError: weights of another model.
        """
        model = as_model(self.cfg.model, self.num_classes, None)
        try:
            model.load_state_dict(self.state)
        except RuntimeError as error:
            path = self.folder / "best.ckpt"
            raise ValueError(
                f"{path} does not fit {self.cfg.model} with {self.num_classes} classes: {error}"
            ) from error
        return model.eval()

    def check_classes(self, splits: Splits, data: Data) -> None:
        """Refuse data whose classes are not the run's: every answer would count as wrong.

        Raises:
            ValueError: with the first class that differs.
        """
        hint = (
            "Pass data whose class folders are those that the run was trained on, or another run."
        )
        if splits.num_classes != self.num_classes:
            raise ValueError(
                f"{self.folder} was trained on {self.num_classes} classes, "
                f"and the data {data.name} has "
                f"{splits.num_classes}. {hint}"
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


def read(folder: Path) -> Saved:
    """Read a run's settings and best weights.

    Raises:
        ValueError: no run there, settings that no run has, or a checkpoint that cannot be read.
    """
    config, best = folder / "config.yaml", folder / "best.ckpt"
    if not config.is_file() or not best.is_file():
        raise ValueError(
            f"{folder} is not a run's folder: it must hold config.yaml and best.ckpt, as fit.py "
            "writes them."
        )
    # The checkpoint first: a command that replaces a run writes the settings first, so weights of
    # another run are never taken for those of these settings.
    checkpoint = read_checkpoint(best)
    cfg = read_config(config)
    state = {name.removeprefix("model."): value for name, value in checkpoint["state_dict"].items()}
    saved = Saved(folder, cfg, state, _names(checkpoint.get("classes")))
    if saved.num_classes < 1:
        raise ValueError(f"{best} holds no classifier's weights. Name another run.")
    return saved


def finished(cfg: Config) -> Saved:
    """Read the finished run of these settings; how it was attacked may differ.

    Raises:
        ValueError: as `read`; or another command has replaced it.
    """
    found = read(run_folder(cfg))
    # in another process of this run, the first may still be writing the metrics
    whole = not is_first() or read_metrics(found.folder) is not None
    if whole and same_training(found.cfg, cfg):
        return found
    raise ValueError(
        f"{found.folder} no longer holds the run that was trained there for this one: another "
        "command has replaced it. Run this command again, and one of the two with another "
        "runs=DIR."
    )


def same_training(one: Config, other: Config) -> bool:
    """Return whether two runs are the same but for how they are attacked again."""
    return same_but_attack(result_settings(one), result_settings(other))


def same_but_attack(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Return whether the settings of two runs are the same but for `reattack`."""
    unattacked = {"reattack": None}
    return {**one, **unattacked} == {**other, **unattacked}


def damage(run: RunFolder) -> str | None:
    """Return what is wrong with the files of a run that would be reused or resumed.

    None if they are whole, or if there are none.
    """
    folder, at = run.folder, run.stage()
    if at == "new" or (at == "other" and not (folder / "best.ckpt").is_file()):
        return None
    try:
        read(folder)
        if at == "begun":
            read_checkpoint(folder / "last.ckpt")
    except ValueError as error:
        return str(error).split(". ")[0].rstrip(".")
    return None


def other_data(run: RunFolder, splits: Splits) -> str | None:
    """Return in what the data that a run in its folder was trained on differ from these.

    None where they do not, or where there is no such run.
    """
    for checkpoint in _checkpoints(run):
        if _names(checkpoint.get("classes")) not in (None, splits.classes):
            return "it was trained on other classes"
        if checkpoint.get("files") not in (None, splits.files):
            return "the files that it was trained on are not those that are there now"
    return None


def other_weights(run: RunFolder, weights: str | None) -> str | None:
    """Return that a run in its folder began with other weights than the file of `weights=` holds
    now.

    None where it did not, or where there is no such run or file.
    """
    if weights is None or not Path(weights).is_file():
        return None
    now = digest(weights)
    for checkpoint in _checkpoints(run):
        if checkpoint.get("weights") not in (None, now):
            return f"{weights} no longer holds the weights that it began with"
    return None


def _checkpoints(run: RunFolder) -> Iterator[dict[str, Any]]:
    """Yield the checkpoints of a run in its folder."""
    for name in ("best.ckpt", "last.ckpt"):
        if run.stage() in ("begun", "trained", "finished") and (run.folder / name).is_file():
            yield read_checkpoint(run.folder / name)


def read_config(path: Path) -> Config:
    """Read a run's settings: known keys with values of their types, none looked up elsewhere.

    Raises:
        ValueError: with what is wrong, and what a run's settings may be.
    """
    values = read_settings(path)
    try:
        cfg = OmegaConf.merge(OmegaConf.structured(Config), values)
        for key in sorted(OmegaConf.missing_keys(cfg)):
            raise ValueError(f"{key} is missing")
        if not re.fullmatch(r"[\w.-]+", cfg.recipe):
            raise ValueError(f"recipe must be a name; got {cfg.recipe!r}.")
        one_of("data.name", cfg.data.name, DATA)
        if cfg.model not in OWN:
            one_of("model", cfg.model, names())
        scene_of(cfg)
    except (OmegaConfBaseException, ValueError, TypeError) as error:
        said = str(error).splitlines()[0].rstrip(".")
        raise ValueError(
            f"{path} is not a run's settings: {said}. A run holds the settings of training/fit.py "
            "alone, as this version writes them."
        ) from None
    cfg.data.download = False  # that a folder asks for: only a command line may
    return as_config(cfg)  # type: ignore[arg-type]


def baseline_of(run: Saved) -> Saved | None:
    """Read the run that this one is compared with, where it is beside it with the same settings.

    None where there is none; a note says why if its folder is there.
    """
    wanted = baseline_config(run.cfg)
    if wanted is None:
        return None
    folder = Path(os.path.abspath(run.folder)).parent.parent / wanted.recipe / f"seed{run.cfg.seed}"
    if not (folder / "metrics.json").is_file():
        return None
    try:
        found = read(folder)
    except ValueError as error:
        wanted.runs = str(folder.parent.parent)
        again = shlex.join(["python", "training/fit.py", *command_line(wanted), "resume=false"])
        print(
            f"note: no baseline is attacked beside this run. {error}\n"
            f"This trains it again:\n  {again}"
        )
        return None
    if not same_training(found.cfg, wanted):
        print(
            f"note: {folder} was trained with other settings: "
            "no baseline is attacked beside this run."
        )
        return None
    return found


def trained(folder: Path) -> dict[str, Any] | None:
    """Read what a run's metrics say about its training; None if they are missing or damaged."""
    train = (read_metrics(folder) or {}).get("train")
    if not isinstance(train, dict) or not isinstance(train.get("history"), list):
        return None
    rows = [train | {"history": 0, "init": 0}, *train["history"]]
    plain = all(isinstance(row, Mapping) and all(map(_is_number, row.values())) for row in rows)
    return train if plain and train.get("init") in ("random", "clean") else None


def _names(found: Any) -> dict[int, str] | None:
    if not isinstance(found, dict):
        return None
    return {int(number): str(name) for number, name in found.items()}


def _is_number(value: Any) -> bool:
    return value is None or (
        isinstance(value, Real) and not isinstance(value, bool) and not math.isinf(value)
    )
