"""A trained classifier to attack: a run's, or one with given weights."""

import time
from pathlib import Path
from typing import Any, NamedTuple

from torch import nn

from moireaug.evaluation.visibility import LPIPS
from moireaug.mixtures import as_scenes
from training.attack.protocol import Protocol, protocol_of
from training.config.scenes import shrink_text
from training.config.schema import Config, Reattack, ReattackConfig
from training.data.load import load
from training.data.splits import Splits
from training.models.classifiers import as_model, check_side, class_names
from training.runs.identity import fingerprint_of, group_of
from training.runs.layout import METRICS, REATTACKS, RECORDS
from training.runs.run import Run
from training.runs.trained import TrainedRun
from training.system.files import make_folder


class Subject(NamedTuple):
    """A classifier to attack.

    Args:
        model: classifier of [0, 1] images (B, 3, H, W), which returns logits (B, classes).
        records: folder of the records of finished jobs.
        folder: folder of the results.
        seconds: time spent so far, by phase.
    """

    name: str
    model: nn.Module
    splits: Splits
    protocol: Protocol
    records: Path
    folder: Path
    seconds: dict[str, float]


def subject_of_run(cfg: ReattackConfig, run: TrainedRun, home: Path) -> Subject:
    """Return the best checkpoint of a run.

    Args:
        home: folder of the records and the results: the run's own, or where that cannot be written
            another.
    """
    lpips = lpips_of(cfg)
    make_folder(home / REATTACKS)
    if not (run.folder / METRICS).is_file():
        print(
            f"note: the run in {run.folder} is not finished; its best checkpoint so far is "
            "attacked."
        )
    start = time.perf_counter()
    splits = load(cfg.data, cfg.train.target)
    if run.original:  # which answers the classes of its own
        splits = splits._replace(classes=run.classes or {}, num_classes=run.num_classes)
    run.check_classes(splits, cfg.data)
    model, protocol = run.model(), protocol_of(cfg, splits, lpips, run.original_model())
    same_data = Run(cfg).settings["data"] == Run(run.cfg).settings["data"]
    name = protocol_name(cfg, protocol.batches.n, with_data=not same_data)
    folder = home / REATTACKS / name / cfg.suite
    seconds = {"data": time.perf_counter() - start}
    return Subject(cfg.recipe, model, splits, protocol, home / RECORDS, folder, seconds)


def subject_of_weights(cfg: ReattackConfig) -> Subject:
    """Return a named model with given weights."""
    if cfg.weights is None:
        raise ValueError(
            "nothing to attack: pass run=DIR of a trained run, or model=NAME with weights=FILE "
            "(or torchvision's name of weights, such as DEFAULT)."
        )
    lpips = lpips_of(cfg)
    home = Path(cfg.runs) / REATTACKS / cfg.model
    make_folder(home)
    start = time.perf_counter()
    splits = load(cfg.data)
    model = as_model(cfg.model, splits.num_classes, cfg.weights, whole=True)
    check_side(model, cfg.model, cfg.data.size)
    if cfg.data.class_index:
        splits = splits._replace(classes=class_names(cfg.model) or splits.classes)
    protocol = protocol_of(cfg, splits, lpips)
    name = protocol_name(cfg, protocol.batches.n, with_data=True)
    folder = home / name / cfg.suite
    seconds = {"data": time.perf_counter() - start}
    return Subject(cfg.model, model, splits, protocol, home / RECORDS, folder, seconds)


def lpips_of(cfg: ReattackConfig) -> LPIPS | None:
    """Return the network that measures LPIPS; None where no weights are given for it."""
    if cfg.lpips is None:
        return None
    lpips = LPIPS(cfg.lpips)
    lpips.require_side(cfg.data.size)
    return lpips


def protocol_name(cfg: ReattackConfig, n: int, *, with_data: bool) -> str:
    """Return the name of a folder for all attacks with these settings."""
    parts = [scene_name(cfg), f"n{n}", f"steps{cfg.reattack.steps}"]
    changes: dict[str, Any] = {}
    for name in ("eps", "bound", "seed", "batch_size"):
        value = getattr(cfg.reattack, name)
        if value != getattr(Reattack, name):
            changes[name] = value
    for name in ("targets", "networks", "demoire", "lpips"):
        if value := getattr(cfg, name):
            changes[name] = value
    if with_data:
        parts.insert(0, group_of(cfg.data, Config.model) or cfg.data.name)
        changes |= {"data": Run(cfg).settings["data"], "weights": cfg.weights}
    if changes:
        parts.append(fingerprint_of(changes)[:6])
    return "-".join(parts)


def scene_name(cfg: Config) -> str:
    """Return a preset's name, or one that changes with any field; for crops, with their shrink."""
    name = cfg.scene
    if not isinstance(name, str):
        name = f"custom-{fingerprint_of(as_scenes(cfg.scene).to_dict())[:6]}"
    if cfg.shrink is None:
        return name
    return f"{name}-shrink-{shrink_text(cfg.shrink).replace(' ', '-')}"
