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
from omegaconf import DictConfig, OmegaConf
from torch import nn
from tqdm import tqdm

from moireaug.attacks import MoireAttack
from moireaug.evaluation import Row, climb, ladder, middle, paired_gain, report, trust
from moireaug.evaluation.given import Given
from moireaug.evaluation.pictures import examples
from moireaug.evaluation.store import write_text
from moireaug.evaluation.suites import GROUPS, SUITES
from moireaug.evaluation.sweep import Index, complete, sweep
from moireaug.fields import one_of
from training import runs
from training.classifier import as_model
from training.data import Splits, load
from training.places import Places
from training.schema import ReattackConfig, check_keys, register, scene_of
from training.suites import evaluate


def device(cfg: DictConfig) -> torch.device:
    """The GPU where there is one, unless `trainer.accelerator=cpu` asks for the CPU."""
    return torch.device("cuda" if torch.cuda.is_available() and cfg.trainer.accelerator != "cpu" else "cpu")


def check(cfg: DictConfig) -> None:
    """Refuse settings of scene and re-attack before any time is spent.

    Raises:
        TypeError, ValueError: with what was got and what is allowed.
    """
    scene, r = scene_of(cfg), cfg.reattack
    for name in ("n", "batch_size"):
        if r[name] is not None and r[name] < 1:
            raise ValueError(f"reattack.{name} must be at least 1; got {r[name]}.")
    one_of("suite", cfg.get("suite", "ladder"), ("ladder", *SUITES, *GROUPS, "trust"))
    MoireAttack(model=torch.nn.Identity(), scene=scene, eps=list(r.eps), steps=r.steps)


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
    seconds: dict[str, float],
) -> dict[str, Any]:
    """Write report.html, then metrics.json, and print the summary. Returns the metrics."""
    out.mkdir(parents=True, exist_ok=True)
    began = time.perf_counter()
    models = {cfg.model if cfg.recipe == "pretrained" else cfg.recipe: model} | (
        {"clean": beside(cfg, baseline, splits)} if baseline else {}
    )
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


def beside(cfg: DictConfig, baseline: dict[str, Any], splits: Splits) -> nn.Module:
    """The baseline's model, for the pictures."""
    return from_run(Path(cfg.runs) / baseline["recipe"] / f"seed{baseline['seed']}", splits.num_classes)[0]


def from_run(run: Path, num_classes: int | None = None) -> tuple[nn.Module, DictConfig]:
    """The best model of a run, and the settings it was trained with.

    Raises:
        ValueError: no run there, or a checkpoint that cannot be read.
    """
    if not (run / "config.yaml").is_file() or not (run / "best.ckpt").is_file():
        raise ValueError(
            f"run={run} is not a run's folder: it must hold config.yaml and best.ckpt, as fit.py writes them."
        )
    if not (run / "metrics.json").is_file():
        print(f"note: the run in {run} was not finished; its best checkpoint so far is attacked.")
    cfg = OmegaConf.load(run / "config.yaml")
    state = runs.read_checkpoint(run / "best.ckpt")["state_dict"]
    state = {k.removeprefix("model."): v for k, v in state.items()}
    head = next(v for k, v in reversed(state.items()) if k.endswith("weight"))
    model = as_model(cfg.model, num_classes or len(head), None)
    try:
        model.load_state_dict(state)
    except RuntimeError as error:
        raise ValueError(f"{run / 'best.ckpt'} does not fit {cfg.model} with {num_classes} classes: {error}") from error
    return model.to(device(cfg)).eval(), cfg


def reattack(cfg: DictConfig, given: list[str]) -> dict[str, Any]:
    """Attack a run or a named model; returns the metrics.

    Args:
        cfg: the composed configuration. given: the overrides on the command line, which go before a run's own settings.
    """
    check(cfg)
    began, baseline, train = time.perf_counter(), None, None
    if cfg.run is None:
        if cfg.weights is None:
            raise ValueError(
                "nothing to attack: pass run=DIR of a trained run, or model=NAME with weights=FILE (or torchvision's "
                "name of weights, such as DEFAULT)."
            )
        splits = load(cfg.data)
        model = as_model(cfg.model, splits.num_classes, cfg.weights, whole=True).to(device(cfg)).eval()
        splits = splits._replace(classes=(cfg.data.class_index and published_names(cfg.model)) or splits.classes)
        out, title = Path(cfg.runs) / "reattack" / cfg.model, cfg.model
        if cfg.suite != "ladder":
            return evaluate(model, splits, cfg, out / scene_name(cfg))
    else:
        run = Path(cfg.run)
        model, own = from_run(run)
        known, train = None, (runs.read_metrics(run) or {}).get("train")
        if own.recipe != "clean":
            twin = run.parent.parent / "clean" / f"seed{own.seed}"
            known = runs.read_metrics(twin)
            if known and known["fingerprint"] != runs.fingerprint(runs.settings(runs.plain_twin(own))):
                print(f"{twin} was trained with other settings: no baseline is attacked beside this run.")
                known = None
        own = OmegaConf.merge({"suite": "ladder", "targets": None, "demoire": None}, own)
        for key in (o.lstrip("+~").split("=", 1)[0] for o in given):
            if key != "run":
                OmegaConf.update(own, key, OmegaConf.select(cfg, key))
        own.runs = str(run.parent.parent)
        cfg, splits, title = own, load(own.data), own.recipe
        out = run / "reattack" / scene_name(cfg)
        if cfg.suite != "ladder":
            return evaluate(model, splits, cfg, out)
        if known:
            plainly, _ = from_run(twin)
            baseline = known | describe(attack_again(plainly, splits, cfg, title="clean"))
    seconds = {"data": time.perf_counter() - began}
    began = time.perf_counter()
    rows = attack_again(model, splits, cfg, title=title)
    seconds["re-attack"] = time.perf_counter() - began
    return publish(out, cfg, model, splits, rows, train=train, baseline=baseline, seconds=seconds)


@hydra.main(version_base="1.3", config_path=None, config_name="reattack")
def main(cfg: DictConfig) -> None:
    try:
        reattack(cfg, list(hydra.core.hydra_config.HydraConfig.get().overrides.task))
    except (ValueError, TypeError) as error:
        raise SystemExit(f"error: {error}") from None


register()
if __name__ == "__main__":
    check_keys(sys.argv[1:], ReattackConfig)
    main()
