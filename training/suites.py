"""A suite on one model: kept as it goes, resumed where it stopped, shared among processes."""

from __future__ import annotations

import hashlib
import importlib
import json
import time
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import lightning as L
import numpy as np
import torch
from omegaconf import DictConfig, OmegaConf
from PIL import Image
from torch import Tensor, nn
from torch.utils.data import Subset
from tqdm import tqdm

from moireaug.defenses import DEFENSES, Quilting
from moireaug.evaluation import suite_report, trust
from moireaug.evaluation.adaptive import Defence
from moireaug.evaluation.grids import tidy
from moireaug.evaluation.ladder import middle
from moireaug.evaluation.rungs import CLEAN, Rung
from moireaug.evaluation.store import Store, write_text
from moireaug.evaluation.suites import Given, tables_of
from moireaug.evaluation.sweep import MODEL, Job, Record, complete, sweep
from moireaug.evaluation.table import Table
from training import runs
from training.classifier import as_model
from training.data import Splits
from training.models import names
from training.places import Places
from training.schema import scene_of

PAPER_TARGETS = ("resnet50", "resnet34", "densenet121", "vgg16", "vgg19")
TRUST_N = 100  # images that the checks look at in the report of another suite
BANK = 50_000  # patches of the image quilting


def evaluate(model: nn.Module, splits: Splits, cfg: DictConfig, out: Path) -> dict[str, Any]:
    """Run `cfg.suite`, or take up where it was left, and write its report into `out`/<suite>/. Returns the metrics."""
    fabric = _fabric(cfg)
    r, scene = cfg.reattack, scene_of(cfg)
    model, batches = model.to(fabric.device).eval(), Places(splits, cfg, fabric.device)
    began = time.perf_counter()
    given = Given(scene=scene, eps=middle(r.eps), steps=r.steps, targets=_targets(cfg, splits, fabric.device))
    mark = runs.fingerprint(_settings(cfg, model, given, batches.size))
    store = Store(out / f"records-{mark}", fabric.global_rank)
    given = _with_bank(given, cfg, splits, batches, store.folder, fabric)
    made = tables_of(cfg.suite, given)
    plans = [(complete([job for t in made for job in t.jobs()]), range(len(batches)))] if made else []
    trusted = len(batches) if cfg.suite == "trust" else min(len(batches), -(-TRUST_N // batches.size))
    plans.append((complete(trust.jobs(given)), range(trusted)))
    seconds = {"preparation": time.perf_counter() - began}
    began = time.perf_counter()
    _run(plans, model, batches, given, cfg, splits, store, fabric, _wanted(made))
    fabric.barrier()
    seconds["attacks"] = time.perf_counter() - began
    if fabric.global_rank:
        return {}
    records = store.records()
    grids = [(table, tidy(table, records)) for table in made]
    checked = [rec for rec in records if rec["place"] < trusted]
    metrics: dict[str, Any] = {
        "suite": cfg.suite, "recipe": cfg.recipe, "seed": cfg.seed, "data": cfg.data.name, "model": cfg.model,
        "n": batches.n, "steps": r.steps, "eps": given.eps,
        "scene_name": cfg.scene if isinstance(cfg.scene, str) else "custom",
        "scene": scene.to_dict(), "plan": str(scene.plan()),
        "trust": [c.to_dict() for c in trust.checks(given, checked)], "trust_n": min(batches.n, trusted * batches.size),
        "tables": {table.name: rows for table, rows in grids}, "time": seconds,
        "config": runs.settings(cfg), "fingerprint": mark, "environment": runs.environment(),
        "command": runs.command(),
    }  # fmt: skip
    shown = {t.name: _pictures(t, records, store.folder, splits.classes, cfg.model) for t in made}
    folder = out / cfg.suite
    suite_report.write(folder, metrics, grids, shown)
    write_text(folder / "metrics.json", json.dumps(metrics, indent=1))
    print(suite_report.summary(metrics, grids))
    print(f"Report: {folder / 'report.html'}")
    return metrics


def _fabric(cfg: DictConfig) -> L.Fabric:
    """The processes that share the work: Lightning's own, by the same settings as training."""
    t = OmegaConf.to_container(cfg.trainer)
    kind = "cpu" if t["accelerator"] == "auto" and not torch.cuda.is_available() else t["accelerator"]  # type: ignore[index,call-overload]
    fabric = L.Fabric(accelerator=kind, devices=t["devices"], num_nodes=t["num_nodes"], strategy=t["strategy"])  # type: ignore[index,call-overload]
    fabric.launch()
    return fabric


def _targets(cfg: DictConfig, splits: Splits, device: torch.device) -> dict[str, nn.Module | None]:
    """Models to transfer to: those given, by a file of weights or a run's folder; the paper's, without weights.

    Raises:
        ValueError: a target that is neither a model's name with weights nor a run.
    """
    if cfg.suite not in ("transfer", "paper", "trust"):
        return {}
    found: dict[str, nn.Module | None] = {}
    classes = 1000 if cfg.data.class_index else splits.num_classes
    for name, weights in (cfg.targets or {}).items():
        if weights is not None and (Path(weights) / "best.ckpt").is_file():
            from training.reattack import from_run

            found[name] = from_run(Path(weights), splits.num_classes)[0].to(device)
        elif name in names():
            found[name] = weights and as_model(name, classes, weights, whole=True).to(device).eval()
        else:
            raise ValueError(
                f"targets.{name}={weights!r} is neither a run's folder with best.ckpt nor a model's name with weights. "
                "Pass targets='{NAME: DIR}', or targets='{resnet18: FILE}'."
            )
    published = PAPER_TARGETS if cfg.data.class_index else ()
    return found | {name: None for name in published if name not in found}


def _settings(cfg: DictConfig, model: nn.Module, given: Given, size: int) -> dict[str, Any]:
    """What the records depend on: never the suite, so that suites share them."""
    kept = ("scene", "model", "data", "demoire")
    settings = {k: v for k, v in runs.settings(cfg).items() if k in kept}
    weights = {name: _digest(m) for name, m in {"model": model, **given.targets}.items() if m is not None}
    how = runs.settings(cfg)["reattack"] | {"batch_size": size}  # the draws are by batch
    return settings | {"reattack": how, "weights": weights, "version": version("moireaug")}


def _digest(model: nn.Module) -> str:
    """Sixteen hex digits that change with any weight."""
    sums = hashlib.sha256()
    for name, value in model.state_dict().items():
        sums.update(name.encode())
        sums.update(value.detach().cpu().contiguous().view(-1).view(torch.uint8).numpy())
    return sums.hexdigest()[:16]


def _with_bank(given: Given, cfg: DictConfig, splits: Splits, batches: Places, folder: Path, fabric: L.Fabric) -> Given:
    """The paper's defences, image quilting from training images, and a network against moiré where one is named."""
    defences: dict[str, Defence] = {name: make() for name, make in DEFENSES.items()}
    without: dict[str, str] = {}
    if cfg.suite in ("defences", "paper"):
        images = batches.others(splits)
        if len(images):
            if fabric.global_rank == 0:
                _quilting(images, folder)
            fabric.barrier()
            defences["quilting"] = _quilting(images, folder)
        else:
            without["Quilting"] = "there are no images to make its patch bank from beside those attacked"
    if cfg.demoire:
        defences["demoire"] = _callable(cfg.demoire)
    return Given(scene=given.scene, eps=given.eps, steps=given.steps, targets=given.targets, defences=defences,
                 without=without)  # fmt: skip


def _quilting(images: Subset, folder: Path) -> Quilting:
    stack = torch.stack([images[i][0] for i in range(min(len(images), 500))]).float() / 255
    return Quilting.from_images(stack, patches=BANK, seed=0, cache=folder / "quilting.pt")


def _callable(name: str) -> Defence:
    """What `package.module:name` names.

    Raises:
        ValueError: nothing of that name, or nothing that can be called.
    """
    module, _, attribute = name.partition(":")
    try:
        found = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"demoire={name!r} could not be imported ({error}). Pass package.module:callable.") from error
    if not callable(found):
        raise ValueError(f"demoire={name!r} is a {type(found).__name__}, not a callable on (B, 3, H, W) in [0, 1].")
    return found.eval() if isinstance(found, nn.Module) else found


def _wanted(made: Sequence[Table]) -> set[str]:
    return {rung.name for t in made for key in t.pictures for rung in t.cells[key].rungs}


def _run(
    plans: Sequence[tuple[list[Job], range]], model: nn.Module, batches: Places, given: Given, cfg: DictConfig,
    splits: Splits, store: Store, fabric: L.Fabric, wanted: set[str],
) -> None:  # fmt: skip
    """This process's share of the places: every world_size-th, each record kept as soon as it is known."""
    first: dict[str, int] = {}

    def watch(place: int, rung: Rung, shown: Tensor, said: Mapping[str, list[int]]) -> None:
        if place == 0 and rung.name == CLEAN.name and MODEL.name in said:
            labels = batches[0][1].tolist()
            first["row"] = next((i for i, y in enumerate(labels) if said[MODEL.name][i] == y), 0)
        if place == 0 and rung.name in wanted:
            row = first.get("row", _first(store.records()))
            pixels = (shown[row].float().cpu() * 255).round().to(torch.uint8).permute(1, 2, 0).numpy()
            path = _file(store.folder, rung.name)
            path.parent.mkdir(exist_ok=True)
            Image.fromarray(pixels).save(path)

    mine = [(jobs, [p for p in places if p % fabric.world_size == fabric.global_rank]) for jobs, places in plans]
    total = sum(len(jobs) * len(places) for jobs, places in mine)
    with tqdm(total=total, unit="rung", leave=False, disable=fabric.global_rank > 0) as bar:
        for jobs, places in mine:
            done, titles = store.done(), [job.rung.title for job in jobs]
            found = sweep(model, batches.__getitem__, places, given.scene, jobs, seed=cfg.reattack.seed,
                          classes=splits.num_classes, done=done, watch=watch)  # fmt: skip
            for i, records in enumerate(found):
                store.append(records)
                bar.set_description(titles[i % len(titles)][:40])
                bar.update()


def _first(records: Sequence[Record]) -> int:
    """The first image of the first batch that the model has right: the one that reports show."""
    for r in records:
        if (r["place"], r["rung"], r["judge"]) == (0, CLEAN.name, MODEL.name):
            return next((i for i, (p, y) in enumerate(zip(r["predicted"], r["labels"], strict=True)) if p == y), 0)
    return 0


def _file(folder: Path, rung: str) -> Path:
    return folder / "pictures" / f"{hashlib.sha256(rung.encode()).hexdigest()[:16]}.png"


def _pictures(
    table: Table, records: Sequence[Record], folder: Path, classes: Mapping[int, str], model: str
) -> list[dict[str, Any]]:
    """The table's pictures of one image, each with what the model says of it."""
    cells, row, label = [], _first(records), None
    said = {r["rung"]: r for r in records if r["place"] == 0 and r["judge"] == MODEL.name}
    for key in table.pictures:
        (rung,) = table.cells[key].rungs
        path = _file(folder, rung.name)
        if path.is_file() and rung.name in said:
            record = said[rung.name]
            label, answer = record["labels"][row], record["predicted"][row]
            known = classes.get(answer, str(answer))
            predictions = [(model, known, answer == label)]
            image = np.array(Image.open(path))
            cells.append({"title": _title(table, key), "image": image, "predictions": predictions})
    return [{"label": classes.get(label, str(label)), "cells": cells}] if cells else []


def _title(table: Table, key: tuple[str, str]) -> str:
    """What tells a picture from its neighbours: its row, its column, or both."""
    rows, columns = ({k[i] for k in table.pictures} for i in (0, 1))
    return ", ".join(part for part, many in zip(key, (rows, columns), strict=True) if len(many) > 1) or key[0]
