"""Attack any classifier: a run's best checkpoint, or a torchvision model with given weights on a folder of images.

    python training/reattack.py run=runs/moire_at/seed0
    python training/reattack.py run=runs/moire_at/seed0 scene=dashcam_at_led_sign reattack.n=1600
    python training/reattack.py model=mobilenet_v2 weights=FILE data=folder data.root=DIR data.class_index=CSV \\
        data.size=224 scene=paper_code suite=paper targets='{resnet18: FILE, resnet50: FILE}'

Writes report.html and metrics.json: with `run=` into <run>/reattack/<scene>/, else into runs/reattack/<model>/. A suite
(see moireaug/evaluation/suites.py) writes them, tables.md and results.csv into a folder of its name there, keeps what
it has computed as it goes, and goes on from there when the same command is given again.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

import hydra
import torch
import torchvision
from omegaconf import DictConfig
from torch import nn
from tqdm import tqdm

from moireaug.attacks import MoireAttack
from moireaug.evaluation import Row, climb, ladder, middle, paired_gain, report, trust
from moireaug.evaluation.given import Given
from moireaug.evaluation.pictures import examples
from moireaug.evaluation.store import write_text
from moireaug.evaluation.suites import GROUPS, SUITES
from moireaug.evaluation.sweep import Index, complete, sweep
from moireaug.scene.fields import one_of
from training import bounds, commands, overrides, runs, saved
from training.classifier import as_model
from training.data import AUGMENT, Splits, load
from training.places import Places
from training.schema import ReattackConfig, register, scene_of
from training.suites import evaluate


def device(cfg: DictConfig) -> torch.device:
    """The GPU where there is one, unless `trainer.accelerator=cpu` asks for the CPU."""
    return torch.device("cuda" if torch.cuda.is_available() and cfg.trainer.accelerator != "cpu" else "cpu")


def check(cfg: DictConfig) -> None:
    """Refuse settings of scene and re-attack before any time is spent.

    Raises:
        TypeError, ValueError: with what was got and what is allowed.
    """
    bounds.check(cfg)
    one_of("suite", cfg.get("suite", "ladder"), ("ladder", *SUITES, *GROUPS, "trust"))
    one_of("data.augment", cfg.data.augment, AUGMENT)
    MoireAttack(model=torch.nn.Identity(), scene=scene_of(cfg), eps=list(cfg.reattack.eps), steps=cfg.reattack.steps)


def scene_name(cfg: DictConfig) -> str:
    """A preset's name, or one that changes with any field."""
    return cfg.scene if isinstance(cfg.scene, str) else f"custom-{runs.fingerprint(scene_of(cfg).to_dict())[:6]}"


def attack_again(model: nn.Module, splits: Splits, cfg: DictConfig, title: str) -> list[Row]:
    """Climb the ladder on the test images, with a progress bar; the shots depend on the seed alone."""
    r, model = cfg.reattack, model.to(device(cfg)).eval()
    rungs, batches = ladder(tuple(r.eps), r.steps), Places(splits, cfg, device(cfg))
    steps = climb(model, batches, scene_of(cfg), rungs, seed=r.seed)
    *_, rows = tqdm(steps, total=len(batches), desc=f"Attacking {title} again", unit="batch", leave=False)
    return rows


def checked(model: nn.Module, splits: Splits, cfg: DictConfig) -> dict[str, Any]:
    """Whether the attack's figures can be trusted, by its checks on the first batch."""
    r, batches = cfg.reattack, Places(splits, cfg, device(cfg))
    given = Given(scene=scene_of(cfg), eps=middle(r.eps), steps=r.steps)
    jobs = complete(trust.jobs(given))
    found = sweep(model, batches.__getitem__, [0], given.scene, jobs, seed=r.seed)
    bar = tqdm(found, total=len(jobs), desc="Checking the attack", unit="rung", leave=False)
    index = Index(record for new in bar for record in new)
    return {"trust": [c.to_dict() for c in trust.checks(given, index)], "trust_n": min(batches.n, batches.size)}


def publish(
    out: Path,
    cfg: DictConfig,
    model: nn.Module,
    splits: Splits,
    rows: list[Row],
    *,
    train: dict[str, Any] | None,
    baseline: dict[str, Any] | None,
    beside: nn.Module | None,
    seconds: dict[str, float],
) -> dict[str, Any]:
    """Write report.html, then metrics.json, and print the summary. Returns the metrics.

    Args:
        baseline: what is known of the baseline, with its rows. beside: its model, for the pictures.
    """
    began = time.perf_counter()
    models = {cfg.model if cfg.recipe == "pretrained" else cfg.recipe: model}
    if beside is not None:
        models["clean"] = beside.to(device(cfg)).eval()
    images, labels = Places(splits, cfg, device(cfg))[0]
    shown = examples(models, images[:4], labels[:4], scene_of(cfg), middle(cfg.reattack.eps),
                     cfg.reattack.steps, splits.classes, seed=cfg.reattack.seed)  # fmt: skip
    seconds = seconds | {"pictures": time.perf_counter() - began}
    began = time.perf_counter()
    trusted = checked(model, splits, cfg)
    seconds["checks"] = time.perf_counter() - began
    scene = scene_of(cfg)
    metrics: dict[str, Any] = {
        "recipe": cfg.recipe, "seed": cfg.seed, "data": cfg.data.name, "model": cfg.model,
        "train": train, **describe(rows), **trusted, "time": seconds,
        "scene_name": cfg.scene if isinstance(cfg.scene, str) else "custom", "scene": scene.to_dict(),
        "plan": str(scene.plan()), "config": runs.settings(cfg), "fingerprint": runs.fingerprint(runs.settings(cfg)),
        "environment": runs.environment(), "command": runs.command(), "baseline": None, "gain": {}, "gain_interval": {},
    }  # fmt: skip
    if baseline:
        shared = ("recipe", "seed", "data", "model", "clean_accuracy", "train", "reattack")
        metrics["baseline"] = {k: baseline[k] for k in shared}
        for name, ours in metrics["correct"].items():
            if name in baseline["correct"]:
                pair = (torch.tensor([c == "1" for c in s]) for s in (ours, baseline["correct"][name]))
                gain, low, high = paired_gain(*pair)
                metrics["gain"][name], metrics["gain_interval"][name] = gain, [low, high]
    report.write(out / "report.html", metrics, shown)
    write_text(out / "metrics.json", json.dumps(metrics, indent=1))
    print(report.summary(metrics))
    print(f"Report: {out / 'report.html'}")
    return metrics


def published_names(model: str) -> dict[int, str]:
    """The class names that a torchvision model was published with; empty for a model of our own."""
    if model not in torchvision.models.list_models():
        return {}
    return dict(enumerate(torchvision.models.get_model_weights(model).DEFAULT.meta.get("categories", ())))


def describe(rows: list[Row]) -> dict[str, Any]:
    """The rows as plain values, with every image's outcome as a string of 0 and 1, for paired comparisons."""
    outcomes = {r.name: "".join(str(int(c)) for c in r.correct) for r in rows}
    return {"clean_accuracy": rows[0].accuracy, "reattack": [r.to_dict() for r in rows], "correct": outcomes}


def reattack(cfg: DictConfig, given: list[str]) -> dict[str, Any]:
    """Attack a run or a named model; returns the metrics.

    Args:
        cfg: the composed configuration. given: the overrides on the command line, which go before a run's own settings.

    Raises:
        TypeError, ValueError: what cannot be followed, before any time is spent.
    """
    overrides.check(cfg, given)
    return _attack_weights(cfg) if cfg.run is None else _attack_run(cfg, given)


def _attack_weights(cfg: DictConfig) -> dict[str, Any]:
    check(cfg)
    if cfg.weights is None:
        raise ValueError(
            "nothing to attack: pass run=DIR of a trained run, or model=NAME with weights=FILE (or torchvision's "
            "name of weights, such as DEFAULT)."
        )
    out = Path(cfg.runs) / "reattack" / cfg.model
    runs.make(out)
    began = time.perf_counter()
    splits = load(cfg.data)
    model = as_model(cfg.model, splits.num_classes, cfg.weights, whole=True).to(device(cfg)).eval()
    splits = splits._replace(classes=(cfg.data.class_index and published_names(cfg.model)) or splits.classes)
    if cfg.suite != "ladder":
        return evaluate(model, splits, cfg, out / scene_name(cfg))
    seconds = {"data": time.perf_counter() - began}
    began = time.perf_counter()
    rows = attack_again(model, splits, cfg, title=cfg.model)
    seconds["re-attack"] = time.perf_counter() - began
    return publish(out, cfg, model, splits, rows, train=None, baseline=None, beside=None, seconds=seconds)


def _attack_run(cfg: DictConfig, given: list[str]) -> dict[str, Any]:
    found = saved.read(Path(cfg.run))
    cfg = overrides.onto(found.cfg, cfg, given)
    check(cfg)
    out = found.folder / "reattack" / scene_name(cfg)
    runs.make(out)
    if not (found.folder / "metrics.json").is_file():
        print(f"note: the run in {found.folder} was not finished; its best checkpoint so far is attacked.")
    began = time.perf_counter()
    splits = load(cfg.data)
    found.check_classes(splits, cfg.data)
    model = found.model()
    if cfg.suite != "ladder":
        return evaluate(model, splits, cfg, out)
    seconds = {"data": time.perf_counter() - began}
    baseline, beside = None, None
    if twin := saved.baseline_of(found):
        twin.check_classes(splits, cfg.data)
        beside = twin.model()
        baseline = {"recipe": "clean", "seed": twin.cfg.seed, "data": twin.cfg.data.name, "model": twin.cfg.model,
                    "train": saved.trained(twin.folder)}  # fmt: skip
        baseline |= describe(attack_again(beside, splits, cfg, title="clean"))
    began = time.perf_counter()
    rows = attack_again(model, splits, cfg, title=cfg.recipe)
    seconds["re-attack"] = time.perf_counter() - began
    train = saved.trained(found.folder)
    return publish(out, cfg, model, splits, rows, train=train, baseline=baseline, beside=beside, seconds=seconds)


@hydra.main(version_base="1.3", config_path=None, config_name="reattack")
def main(cfg: DictConfig) -> None:
    with commands.sentences(kept="A suite keeps every record"):
        reattack(cfg, list(hydra.core.hydra_config.HydraConfig.get().overrides.task))


register()
if __name__ == "__main__":
    commands.run(main, ReattackConfig)
