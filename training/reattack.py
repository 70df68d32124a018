r"""Attack any classifier: a run's best checkpoint, or a torchvision model with given weights on a
folder of images.

    python training/reattack.py run=runs/moire_at/seed0
    python training/reattack.py run=runs/moire_at/seed0 scene=dashcam_at_led_sign reattack.n=1600
    python training/reattack.py model=mobilenet_v2 weights=FILE data=folder data.root=DIR \
        data.class_index=CSV data.size=224 scene=paper_code suite=paper \
        targets='{resnet18: FILE, resnet50: FILE}'

Writes report.html and metrics.json into <run>/reattack/<scene>-n<images>-steps<steps>/<suite>/, or,
without `run=`, into runs/reattack/<model>/<data>-<scene>-n<images>-steps<steps>/<suite>/; a suite
other than the ladder writes tables.md and results.csv too. The baseline of a run is attacked too,
if its folder holds it with the same settings. Every finished piece is kept in records/: the same
command continues where it stopped, and another suite reuses what is there.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __name__ == "__main__":  # search the repository, not this folder: a user has a models.py too
    sys.path[: not sys.flags.safe_path] = [str(Path(__file__).resolve().parents[1])]

# before torch is loaded, as it sets how torch's threads wait
import training  # noqa: F401  # isort: skip
import time
from dataclasses import replace
from typing import Any

import hydra
import torch
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from torch import nn

from moireaug.attacks import MoireAttack
from moireaug.evaluation import GROUPS, SUITES
from moireaug.evaluation.tables import DEFAULT_EPS
from moireaug.evaluation.visibility import LPIPS
from moireaug.mixtures import as_scenes
from moireaug.scene.fields import one_of
from training.attack.protocol import Attacked, Plan, Protocol, attack, protocol_of
from training.attack.results import compare, describe, publish, publish_suite
from training.attack.suites import fabric_of, suite_config
from training.config import commands, overrides, scenes
from training.config.checks import check_classifier
from training.config.compose import WITH_DATA, register
from training.config.schema import (
    Config,
    Reattack,
    ReattackConfig,
    as_config,
    scene_of,
)
from training.config.settings import with_absolute_paths
from training.data.load import load, require_used
from training.data.splits import Splits
from training.models.classifiers import as_model, check_side, class_names
from training.runs import saved
from training.runs.folder import fingerprint_of, group_of, locked_run, result_settings
from training.runs.saved import Saved
from training.system.files import make_folder

Metrics = dict[str, Any]


def check(cfg: Config) -> None:
    """Refuse invalid settings of scene and re-attack before any time is spent.

    Raises:
        TypeError, ValueError: with what was got and what is allowed.
    """
    check_classifier(cfg)
    one_of("suite", getattr(cfg, "suite", "ladder"), (*SUITES, *GROUPS))
    require_used(cfg.data)
    MoireAttack(
        model=torch.nn.Identity(),
        scene=scene_of(cfg),
        eps=list(DEFAULT_EPS if cfg.reattack.eps is None else cfg.reattack.eps),
        steps=cfg.reattack.steps,
    )


def reattack(cfg: DictConfig | ReattackConfig, given: list[str]) -> Metrics:
    """Attack a run or a named model; returns the metrics, {} in all processes but the first.

    Args:
        cfg: the composed configuration.
        given: the overrides on the command line, which take precedence over a run's own settings.

    Raises:
        TypeError, ValueError: invalid settings, before any time is spent.
    """
    own = as_config(cfg)
    if not isinstance(own, ReattackConfig):
        raise TypeError(f"a re-attack needs a ReattackConfig; got a {type(own).__name__}.")
    own = replace(with_absolute_paths(own), scene=scenes.inlined(own.scene))
    overrides.check(own, given)
    return attack_weights(own) if own.run is None else attack_run(own, given)


def attack_weights(cfg: ReattackConfig) -> Metrics:
    """Attack a named model with given weights."""
    check(cfg)
    if cfg.weights is None:
        raise ValueError(
            "nothing to attack: pass run=DIR of a trained run, or model=NAME with weights=FILE "
            "(or torchvision's "
            "name of weights, such as DEFAULT)."
        )
    lpips = lpips_of(cfg)
    home = Path(cfg.runs) / "reattack" / cfg.model
    make_folder(home)
    began = time.perf_counter()
    splits = load(cfg.data)
    model = as_model(cfg.model, splits.num_classes, cfg.weights, whole=True)
    check_side(model, cfg.model, cfg.data.size)
    if cfg.data.class_index:
        splits = splits._replace(classes=class_names(cfg.model) or splits.classes)
    protocol = protocol_of(cfg, splits)._replace(lpips=lpips)
    out = home / protocol_name(cfg, protocol.batches.n, with_data=True) / cfg.suite
    seconds = {"data": time.perf_counter() - began}
    with locked_run(out):
        if cfg.suite != "ladder":
            return attack_by_suite(cfg, model, splits, protocol, home / "records", out, seconds)
        attacked = attack(model, protocol, home / "records", cfg.model)
        metrics = compare(cfg, describe(attacked), None, None, None)
        seconds |= attacked.seconds
        return publish(out, metrics, {cfg.model: attacked}, splits.classes, seconds)


def attack_run(cfg: ReattackConfig, given: list[str]) -> Metrics:
    """Attack a run's best checkpoint; with the ladder also that of its baseline."""
    found = saved.read(Path(cfg.run))  # type: ignore[arg-type]
    cfg = overrides.onto(found.cfg, cfg, given)
    check(cfg)
    lpips = lpips_of(cfg)
    make_folder(found.folder / "reattack")
    if not (found.folder / "metrics.json").is_file():
        print(
            f"note: the run in {found.folder} is not finished; its best checkpoint so far is "
            f"attacked."
        )
    began = time.perf_counter()
    splits = load(cfg.data)
    found.check_classes(splits, cfg.data)
    model = found.model()
    protocol = protocol_of(cfg, splits)._replace(lpips=lpips)
    same_data = result_settings(cfg)["data"] == result_settings(found.cfg)["data"]
    name = protocol_name(cfg, protocol.batches.n, with_data=not same_data)
    out = found.folder / "reattack" / name / cfg.suite
    records = found.folder / "records"
    seconds = {"data": time.perf_counter() - began}
    with locked_run(out):
        if cfg.suite != "ladder":
            return attack_by_suite(cfg, model, splits, protocol, records, out, seconds)
        attacked = {cfg.recipe: attack(model, protocol, records, cfg.recipe)}
        baseline = None
        if other := saved.baseline_of(found):
            other.check_classes(splits, cfg.data)
            baseline, attacked[other.cfg.recipe] = beside(other, protocol)
        train = saved.trained(found.folder)
        metrics = compare(cfg, describe(attacked[cfg.recipe]), train, None, baseline)
        seconds |= attacked[cfg.recipe].seconds
        return publish(out, metrics, attacked, splits.classes, seconds)


def beside(run: Saved, protocol: Protocol) -> tuple[Metrics, Attacked]:
    """Attack the baseline of a run in the same way; return its metrics and results."""
    cfg = run.cfg
    attacked = attack(run.model(), protocol, run.folder / "records", cfg.recipe, check=False)
    known = {"recipe": cfg.recipe, "seed": cfg.seed, "data": cfg.data.name, "model": cfg.model}
    known["train"] = saved.trained(run.folder)
    return known | describe(attacked), attacked


def attack_by_suite(
    cfg: ReattackConfig,
    model: nn.Module,
    splits: Splits,
    protocol: Protocol,
    records: Path,
    out: Path,
    seconds: dict[str, float],
) -> Metrics:
    """Attack a model by `cfg.suite`, shared among the processes that the trainer's settings ask
    for."""
    fabric = fabric_of(cfg.trainer)
    config = suite_config(cfg, protocol, splits, records, fabric)
    plan = Plan(model, cfg.suite, protocol, records, config)
    plan.run(cfg.suite, fabric.global_rank, fabric.world_size)
    fabric.barrier()
    if fabric.global_rank:
        return {}
    return publish_suite(out, cfg, plan.results(), protocol, splits.classes, seconds)


def lpips_of(cfg: ReattackConfig) -> LPIPS | None:
    """Return what measures LPIPS; None where no weights are given for it.

    Raises:
        ValueError: a file of other weights, or images that are too small for them.
    """
    if cfg.lpips is None:
        return None
    found = LPIPS(cfg.lpips)
    found.require_side(cfg.data.size)
    return found


def protocol_name(cfg: ReattackConfig, n: int, *, with_data: bool) -> str:
    """Return the name of a folder for all attacks with these settings.

    Args:
        n: images. with_data: whether the name includes the data set and the weights.
    """
    parts = [scene_name(cfg.scene), f"n{n}", f"steps{cfg.reattack.steps}"]
    own, usual = cfg.reattack, Reattack()
    odd: dict[str, Any] = {}
    for name in ("eps", "seed", "batch_size"):
        if getattr(own, name) != getattr(usual, name):
            odd[name] = getattr(own, name)
    for name in ("targets", "networks", "demoire", "lpips"):
        if getattr(cfg, name):
            odd[name] = getattr(cfg, name)
    if with_data:
        parts.insert(0, group_of(cfg.data, Config.model) or cfg.data.name)
        odd |= {"data": result_settings(cfg)["data"], "weights": cfg.weights}
    if odd:
        parts.append(fingerprint_of(odd)[:6])
    return "-".join(parts)


def scene_name(scene: Any) -> str:
    """Return a preset's name, or one that changes with any field.

    Args:
        scene: as in the schema.
    """
    if isinstance(scene, str):
        return scene
    return f"custom-{fingerprint_of(as_scenes(scene).to_dict())[:6]}"


@hydra.main(version_base="1.3", config_path=None, config_name="reattack")
def main(cfg: DictConfig) -> None:
    """Run one job of the command line."""
    with commands.sentences(kept="Every record is kept"):
        reattack(cfg, list(HydraConfig.get().overrides.task))


register("reattack", ReattackConfig, WITH_DATA, __doc__)
if __name__ == "__main__":
    commands.run(main, ReattackConfig)
