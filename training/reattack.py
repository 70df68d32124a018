"""Attack any classifier: a run's best checkpoint, or a torchvision model with given weights.

    python training/reattack.py run=runs/moire_at/seed0
    python training/reattack.py run=runs/moire_at/seed0 scene=dashcam_at_led_sign reattack.n=1600
    python training/reattack.py model=mobilenet_v2 weights=FILE data=folder data.root=DIR \\
        data.class_index=CSV data.size=224 scene=paper_code suite=paper \\
        targets='{resnet18: FILE, resnet50: FILE}'

Writes report.html and metrics.json: with `run=` into <run>/reattack/<scene>/, else into
runs/reattack/<model>/. The start and the baseline of a run are attacked beside it where their
folders hold them with the same settings. A suite (see moireaug/evaluation/suites.py) writes
tables.md and results.csv too, into a folder of its name; it keeps what it has computed, and the
same command resumes it.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import hydra
import torch
import torchvision
from omegaconf import DictConfig, OmegaConf
from torch import nn

from moireaug.attacks import MoireAttack
from moireaug.evaluation.suites import GROUPS, SUITES
from moireaug.scene.fields import one_of
from moireaug.scene.scene import as_scene
from training import bounds, commands, overrides, runs, saved
from training.data import AUGMENT, load
from training.models import as_model
from training.results import Protocol, attack_again, compare, describe, device, protocol_of, publish
from training.saved import Saved
from training.schema import Config, ReattackConfig, as_config, register, scene_of
from training.suites import evaluate


def check(cfg: Config) -> None:
    """Refuse settings of scene and re-attack before time is spent.

    Raises:
        TypeError, ValueError: with what was got and what is allowed.
    """
    bounds.check(cfg)
    one_of("suite", getattr(cfg, "suite", "ladder"), ("ladder", *SUITES, *GROUPS, "trust"))
    one_of("data.augment", cfg.data.augment, AUGMENT)
    MoireAttack(
        model=torch.nn.Identity(),
        scene=scene_of(cfg),
        eps=list(cfg.reattack.eps),
        steps=cfg.reattack.steps,
    )


def reattack(cfg: DictConfig | ReattackConfig, given: list[str]) -> dict[str, Any]:
    """Attack a run or a named model; returns the metrics.

    Args:
        cfg: the composed configuration.
        given: the overrides on the command line, which take precedence over a run's own settings.

    Raises:
        TypeError, ValueError: settings that cannot be followed, before time is spent.
    """
    cfg = as_config(cfg)  # type: ignore[assignment]
    overrides.check(cfg, given)
    return attack_weights(cfg) if cfg.run is None else attack_run(cfg, given)


def attack_weights(cfg: ReattackConfig) -> dict[str, Any]:
    """Attack a named model with given weights."""
    check(cfg)
    if cfg.weights is None:
        raise ValueError(
            "nothing to attack: pass run=DIR of a trained run, or model=NAME with weights=FILE "
            "(or torchvision's name of weights, such as DEFAULT)."
        )
    out = Path(cfg.runs) / "reattack" / cfg.model
    runs.make(out)
    began = time.perf_counter()
    splits = load(cfg.data)
    model = (
        as_model(cfg.model, splits.num_classes, cfg.weights, whole=True)
        .to(device(cfg.trainer))
        .eval()
    )
    if cfg.data.class_index:
        splits = splits._replace(classes=published_names(cfg.model) or splits.classes)
    if cfg.suite != "ladder":
        return evaluate(model, splits, OmegaConf.structured(cfg), out / scene_name(cfg.scene))
    seconds = {"data": time.perf_counter() - began}
    began = time.perf_counter()
    protocol = protocol_of(cfg, splits)
    rows = attack_again(model, protocol, title=cfg.model)
    seconds["re-attack"] = time.perf_counter() - began
    metrics = compare(cfg, rows, None, None, None)
    return publish(out, metrics, {cfg.model: model}, protocol, splits.classes, seconds)


def attack_run(cfg: ReattackConfig, given: list[str]) -> dict[str, Any]:
    """Attack a run's best checkpoint, and beside it those of its start and of its baseline."""
    found = saved.read(Path(cfg.run))  # type: ignore[arg-type]
    cfg = overrides.onto(found.cfg, cfg, given)
    check(cfg)
    out = found.folder / "reattack" / scene_name(cfg.scene)
    runs.make(out)
    if not (found.folder / "metrics.json").is_file():
        print(
            f"note: the run in {found.folder} is not finished; "
            "its best checkpoint so far is attacked."
        )
    began = time.perf_counter()
    splits = load(cfg.data)
    found.check_classes(splits, cfg.data)
    model = found.model()
    if cfg.suite != "ladder":
        return evaluate(model, splits, OmegaConf.structured(cfg), out)
    seconds = {"data": time.perf_counter() - began}
    protocol, models = protocol_of(cfg, splits), {cfg.recipe: model}
    start = baseline = None
    if other := saved.start_of(found):
        other.check_classes(splits, cfg.data)
        start = attacked(other, other.model(), protocol)
    if other := saved.baseline_of(found):
        other.check_classes(splits, cfg.data)
        models[other.cfg.recipe] = other.model()
        baseline = attacked(other, models[other.cfg.recipe], protocol)
    began = time.perf_counter()
    rows = attack_again(model, protocol, title=cfg.recipe)
    seconds["re-attack"] = time.perf_counter() - began
    metrics = compare(cfg, rows, saved.trained(found.folder), start, baseline)
    return publish(out, metrics, models, protocol, splits.classes, seconds)


def attacked(run: Saved, model: nn.Module, protocol: Protocol) -> dict[str, Any]:
    """Return the metrics of a run beside the one that is attacked: attacked the same way."""
    cfg = run.cfg
    known = {"recipe": cfg.recipe, "seed": cfg.seed, "data": cfg.data.name, "model": cfg.model}
    known["train"] = saved.trained(run.folder)
    return known | describe(attack_again(model, protocol, title=cfg.recipe))


def scene_name(scene: Any) -> str:
    """Return a preset's name, or one that changes with any field.

    Args:
        scene: as in the schema.
    """
    if isinstance(scene, str):
        return scene
    return f"custom-{runs.fingerprint(as_scene(scene).to_dict())[:6]}"


def published_names(model: str) -> dict[int, str]:
    """Return the class names that a torchvision model was published with; empty for our own."""
    if model not in torchvision.models.list_models():
        return {}
    return dict(
        enumerate(torchvision.models.get_model_weights(model).DEFAULT.meta.get("categories", ()))
    )


@hydra.main(version_base="1.3", config_path=None, config_name="reattack")
def main(cfg: DictConfig) -> None:
    with commands.sentences(kept="A suite keeps every record"):
        reattack(cfg, list(hydra.core.hydra_config.HydraConfig.get().overrides.task))


register()
if __name__ == "__main__":
    commands.run(main, ReattackConfig)
