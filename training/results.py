"""What a trained model is worth: attacked again, compared, and reported."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import nn
from tqdm import tqdm

from moireaug.evaluation import Row, climb, ladder, middle, paired_gain, report, trust
from moireaug.evaluation.given import Given
from moireaug.evaluation.pictures import examples
from moireaug.evaluation.sweep import Index, complete, sweep
from moireaug.files import write_text
from moireaug.scene.scene import Scene
from training import runs
from training.data import Splits
from training.places import Places
from training.schema import Config, Reattack, Trainer, scene_of
from training.train import with_totals

# what metrics.json says of the start and of the baseline
SHARED = ("recipe", "seed", "data", "model", "clean_accuracy", "train", "reattack")
SHOWN = 4  # images of the report's pictures


class Protocol(NamedTuple):
    """Says how every model of a comparison is attacked: on which images, where, how strongly."""

    places: Places
    scene: Scene
    settings: Reattack


def protocol_of(cfg: Config, splits: Splits) -> Protocol:
    """Return how the models of these settings are attacked."""
    return Protocol(Places(splits, cfg, device(cfg.trainer)), scene_of(cfg), cfg.reattack)


def device(trainer: Trainer) -> torch.device:
    """Return the GPU where there is one, unless `trainer.accelerator=cpu` asks for the CPU."""
    return torch.device(
        "cuda" if torch.cuda.is_available() and trainer.accelerator != "cpu" else "cpu"
    )


def attack_again(model: nn.Module, protocol: Protocol, title: str) -> list[Row]:
    """Climb the ladder on the test images, with a progress bar; the shots depend on the seed alone.

    Args:
        title: of the model, for the progress bar.
    """
    places, scene, settings = protocol
    model = model.to(places.device).eval()
    rungs = ladder(tuple(settings.eps), settings.steps)
    steps = climb(model, places, scene, rungs, seed=settings.seed)
    *_, rows = tqdm(
        steps, total=len(places), desc=f"Attacking {title} again", unit="batch", leave=False
    )
    return rows


def checked(model: nn.Module, protocol: Protocol) -> dict[str, Any]:
    """Check on the first batch whether the attack's figures can be trusted."""
    places, scene, settings = protocol
    given = Given(scene=scene, eps=middle(settings.eps), steps=settings.steps)
    jobs = complete(trust.jobs(given))
    found = sweep(model, places.__getitem__, [0], scene, jobs, seed=settings.seed)
    bar = tqdm(found, total=len(jobs), desc="Checking the attack", unit="rung", leave=False)
    index = Index(record for new in bar for record in new)
    checks = [check.to_dict() for check in trust.checks(given, index)]
    return {"trust": checks, "trust_n": min(places.n, places.size)}


def pictures(
    models: Mapping[str, nn.Module], protocol: Protocol, classes: dict[int, str]
) -> list[dict[str, Any]]:
    """Return examples for the report: the first images, with what each model says of them."""
    places, scene, settings = protocol
    moved = {name: model.to(places.device).eval() for name, model in models.items()}
    images, labels = places[0]
    return examples(
        moved,
        images[:SHOWN],
        labels[:SHOWN],
        scene,
        middle(settings.eps),
        settings.steps,
        classes,
        seed=settings.seed,
    )


def describe(rows: list[Row]) -> dict[str, Any]:
    """Return the rows as plain values, and every image's outcome as 0 or 1, for paired gains."""
    outcomes = {r.name: "".join(str(int(c)) for c in r.correct) for r in rows}
    return {
        "clean_accuracy": rows[0].accuracy,
        "reattack": [r.to_dict() for r in rows],
        "correct": outcomes,
    }


def compare(
    cfg: Config,
    rows: list[Row],
    train: Mapping[str, Any] | None,
    start: Mapping[str, Any] | None,
    baseline: Mapping[str, Any] | None,
) -> dict[str, Any]:
    """Return the metrics of a run: its own figures, those of the runs beside it, and the gain.

    Args:
        rows: of the run's re-attack. train: what its training cost, where it was trained here.
        start: metrics of the run whose weights it started from. baseline: metrics of the plainly
            trained run, of as many epochs in all, that the gain is against.
    """
    scene, settings = scene_of(cfg), runs.settings(cfg)
    metrics = {
        "recipe": cfg.recipe,
        "seed": cfg.seed,
        "data": cfg.data.name,
        "model": cfg.model,
        "train": train,
        **describe(rows),
        "scene_name": cfg.scene if isinstance(cfg.scene, str) else "custom",
        "scene": scene.to_dict(),
        "plan": str(scene.plan()),
        "config": settings,
        "fingerprint": runs.fingerprint(settings),
        "environment": runs.environment(),
        "command": runs.command(),
        "start": _shared(start),
        "baseline": _shared(baseline),
        "gain": {},
        "gain_interval": {},
    }
    if baseline:
        metrics |= gains(metrics["correct"], baseline["correct"])
    return metrics


def gains(ours: Mapping[str, str], theirs: Mapping[str, str]) -> dict[str, Any]:
    """Return the gain in accuracy and its interval, by rung, from every image's outcome."""
    gain, interval = {}, {}
    for name in ours:
        if name in theirs:
            gain[name], low, high = paired_gain(_outcomes(ours[name]), _outcomes(theirs[name]))
            interval[name] = [low, high]
    return {"gain": gain, "gain_interval": interval}


def _outcomes(text: str) -> torch.Tensor:
    return torch.tensor([outcome == "1" for outcome in text])


def _shared(known: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """Return what a run's metrics say of a run beside it."""
    if not known:
        return None
    shared = {key: known[key] for key in SHARED}
    train = shared["train"]
    if (
        train and "total_epochs" not in train and train.get("init") == "random"
    ):  # by an earlier version
        shared["train"] = with_totals(train, None)
    return shared


def publish(
    out: Path,
    metrics: dict[str, Any],
    models: Mapping[str, nn.Module],
    protocol: Protocol,
    classes: dict[int, str],
    seconds: Mapping[str, float],
    *,
    check: bool = True,
) -> dict[str, Any]:
    """Write report.html, then metrics.json, and print the summary; returns the whole metrics.

    Args:
        models: by name, for the pictures; the run's own comes first.
        seconds: spent so far, by phase.
        check: whether to check that the attack's figures can be trusted; costs a fraction of it.
    """
    seconds = dict(seconds)
    began = time.perf_counter()
    shown = pictures(models, protocol, classes)
    seconds["pictures"] = time.perf_counter() - began
    if check:
        began = time.perf_counter()
        metrics = metrics | checked(next(iter(models.values())), protocol)
        seconds["checks"] = time.perf_counter() - began
    metrics = metrics | {"time": seconds}
    report.write(out / "report.html", metrics, shown)
    write_text(out / "metrics.json", json.dumps(metrics, indent=1))
    print(report.summary(metrics))
    print(f"Report: {out / 'report.html'}")
    return metrics
