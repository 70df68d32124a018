"""A suite on one model: kept as it goes, resumed where it stopped, shared among processes."""

from __future__ import annotations

import dataclasses
import hashlib
import importlib
import json
import time
from collections.abc import Mapping, Sequence
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

import moireaug
from moireaug.defenses import DEFENSES, Compose, Quilting
from moireaug.evaluation import suite_report, trust, words
from moireaug.evaluation.adaptive import Defence
from moireaug.evaluation.given import Given
from moireaug.evaluation.grids import tidy
from moireaug.evaluation.ladder import middle
from moireaug.evaluation.rungs import CLEAN, Rung
from moireaug.evaluation.store import Store, write_text
from moireaug.evaluation.suites import tables_of
from moireaug.evaluation.sweep import MODEL, Index, Job, complete, digest, sweep
from moireaug.evaluation.table import Table
from training import runs, saved
from training.classifier import as_model
from training.data import Splits
from training.models import names
from training.overrides import USES
from training.places import Places
from training.schema import scene_of

PAPER_TARGETS = ("resnet50", "resnet34", "densenet121", "vgg16", "vgg19")
TRUST_N = 100  # images that the checks look at in the report of another suite
BANK, DONORS = 50_000, 500  # patches of the image quilting, and images that they are drawn from
KEPT = 4  # images of the first batch whose pictures are kept, one below the other
Plan = tuple[list[Job], range]


def evaluate(model: nn.Module, splits: Splits, cfg: DictConfig, out: Path) -> dict[str, Any]:
    """Run `cfg.suite`, or take up where it was left, and write its report into `out`/<suite>/. Returns the metrics.

    Raises:
        ValueError: a target or defence that cannot be had, or records that another process has not finished.
    """
    fabric = _fabric(cfg)
    began, r = time.perf_counter(), cfg.reattack
    model, batches = model.to(fabric.device).eval(), Places(splits, cfg, fabric.device)
    given = Given(scene=scene_of(cfg), eps=middle(r.eps), steps=r.steps, targets=_targets(cfg, splits, fabric.device))
    mark = runs.fingerprint(_settings(cfg, model, batches))
    with Store(out / f"records-{mark}", fabric.global_rank) as store:
        given = _with_defences(given, cfg, splits, batches, store.folder, fabric)
        made = tables_of(cfg.suite, given)
        trusted = len(batches) if cfg.suite == "trust" else min(len(batches), -(-TRUST_N // batches.size))
        plans = [(complete([job for t in made for job in t.jobs()]), range(len(batches)))] if made else []
        plans.append((complete(trust.jobs(given)), range(trusted)))
        seconds = {"preparation": time.perf_counter() - began}
        began = time.perf_counter()
        _run(plans, model, batches, given, r.seed, store, fabric, made)
        fabric.barrier()
        seconds["attacks"] = time.perf_counter() - began
        if fabric.global_rank:
            return {}
        records = store.records()
        index, first = Index(records), Index(rec for rec in records if rec["place"] < trusted)
        _whole(plans, index)
        grids = [(table, tidy(table, index)) for table in made]
        metrics = {
            "suite": cfg.suite, "recipe": cfg.recipe, "seed": cfg.seed, "data": cfg.data.name, "model": cfg.model,
            "n": batches.n, "steps": r.steps, "eps": given.eps,
            "scene_name": cfg.scene if isinstance(cfg.scene, str) else "custom",
            "scene": given.scene.to_dict(), "plan": str(given.scene.plan()),
            "trust": [c.to_dict() for c in trust.checks(given, first)],
            "trust_n": min(batches.n, trusted * batches.size),
            "tables": {table.name: rows for table, rows in grids}, "time": seconds,
            "config": runs.settings(cfg), "fingerprint": mark, "environment": runs.environment(),
            "command": runs.command(),
        }  # fmt: skip
        shown = {t.name: _pictures(t, index, store.folder, splits.classes, cfg.model) for t in made}
    folder = out / cfg.suite
    suite_report.write(folder, metrics, grids, shown)
    write_text(folder / "metrics.json", json.dumps(metrics, indent=1))
    print(suite_report.summary(metrics, grids))
    print(f"Report: {folder / 'report.html'}")
    return metrics


def _fabric(cfg: DictConfig) -> L.Fabric:
    """The processes that share the work: Lightning's own, by the same settings as training."""
    t: dict[str, Any] = OmegaConf.to_container(cfg.trainer)  # type: ignore[assignment]
    kind = "cpu" if t["accelerator"] == "auto" and not torch.cuda.is_available() else t["accelerator"]
    fabric = L.Fabric(accelerator=kind, devices=t["devices"], num_nodes=t["num_nodes"], strategy=t["strategy"])
    fabric.launch()
    return fabric


def _targets(cfg: DictConfig, splits: Splits, device: torch.device) -> dict[str, nn.Module | None]:
    """Models to transfer to: those given, by a file of weights or a run's folder; the paper's, without weights.

    Raises:
        ValueError: a target that is neither a model's name with weights nor a run.
    """
    if cfg.suite not in USES["targets"]:
        return {}
    if cfg.targets is not None and not OmegaConf.is_dict(cfg.targets):
        raise ValueError(f"targets={cfg.targets!r} must be names with weights, as in targets='{{resnet18: FILE}}'.")
    found: dict[str, nn.Module | None] = {}
    for name, weights in (cfg.targets or {}).items():
        if isinstance(weights, str) and (Path(weights) / "best.ckpt").is_file():
            run = saved.read(Path(weights))
            run.check_classes(splits, cfg.data)
            found[name] = run.model().to(device)
        elif name in names():
            found[name] = weights and as_model(name, splits.num_classes, weights, whole=True).to(device).eval()
        else:
            raise ValueError(
                f"targets.{name}={weights!r} is neither a run's folder with best.ckpt nor a model's name with weights. "
                "Pass targets='{NAME: DIR}', or targets='{resnet18: FILE}'."
            )
    published = PAPER_TARGETS if cfg.data.class_index else ()
    return found | {name: None for name in published if name not in found}


def _settings(cfg: DictConfig, model: nn.Module, batches: Places) -> dict[str, Any]:
    """What the records depend on: the model, the images, the scene, the attacks and this package's code; never the
    suite or its targets, so that suites share them."""
    images, labels = batches[0]
    first = hashlib.sha256(images.cpu().numpy().tobytes() + labels.cpu().numpy().tobytes())
    code = hashlib.sha256(b"".join(p.read_bytes() for p in sorted(Path(moireaug.__file__).parent.rglob("*.py"))))
    settings = runs.settings(cfg)
    return {
        "model": digest(model), "data": settings["data"], "first batch": first.hexdigest(),
        "scene": scene_of(cfg).to_dict(), "demoire": cfg.demoire, "code": code.hexdigest(),
        "reattack": settings["reattack"] | {"batch_size": batches.size},  # what is drawn goes by batches
    }  # fmt: skip


def _whole(plans: Sequence[Plan], index: Index) -> None:
    """Refuse to make tables where records are missing.

    Raises:
        ValueError: with how many, and what to do.
    """
    wanted = [(p, (rung.name, j.name)) for jobs, places in plans for p in places for rung, js in jobs for j in js]
    lost = sum(place not in index.get(key, {}) for place, key in wanted)
    if lost:
        raise ValueError(
            f"{lost} of {len(wanted)} records are missing: other processes did not finish, or write to a folder that "
            "this one cannot see. Give the same command again, with runs= on a disk that all nodes share."
        )


def _with_defences(
    given: Given, cfg: DictConfig, splits: Splits, batches: Places, folder: Path, fabric: L.Fabric
) -> Given:
    """The paper's defences, image quilting from training images, and a network against moiré where one is named."""
    network = _callable(cfg.demoire, fabric.device) if cfg.demoire else None  # before a patch bank is made
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
    if network is not None:
        defences["demoire"] = Compose((network,))
    return dataclasses.replace(given, defences=defences, without=without)


def _quilting(images: Subset, folder: Path) -> Quilting:
    stack = torch.stack([images[i][0] for i in range(min(len(images), DONORS))]).float() / 255
    return Quilting.from_images(stack, patches=BANK, seed=0, cache=folder / "quilting.npz")


def _callable(name: str, device: torch.device) -> Defence:
    """What `package.module:name` names.

    Raises:
        ValueError: nothing of that name, or nothing that can be called.
    """
    module, _, attribute = name.partition(":")
    try:
        found = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"demoire={name!r} could not be imported ({error}). Pass package.module:callable.") from error
    if not callable(found) or isinstance(found, type):
        raise ValueError(f"demoire={name!r} is a {type(found).__name__}, not a callable on (B, 3, H, W) in [0, 1].")
    return found.eval().to(device) if isinstance(found, nn.Module) else found


def _run(
    plans: Sequence[Plan], model: nn.Module, batches: Places, given: Given, seed: int, store: Store, fabric: L.Fabric,
    made: Sequence[Table],
) -> None:  # fmt: skip
    """This process's share of the places: every world_size-th, each record kept as soon as it is known."""
    wanted = {rung.name for t in made for key in t.pictures for rung in t.cells[key].rungs}
    # a picture that an earlier suite did not keep is shown again
    undrawn = {(0, rung, MODEL.name) for rung in wanted if not _file(store.folder, rung).is_file()}

    def watch(place: int, rung: Rung, shown: Tensor) -> None:
        if place == 0 and rung.name in wanted:
            some = (shown[:KEPT].float().cpu() * 255).round().to(torch.uint8).permute(0, 2, 3, 1).numpy()
            path = _file(store.folder, rung.name)
            path.parent.mkdir(exist_ok=True)
            Image.fromarray(np.concatenate(some)).save(path)

    mine = [(jobs, [p for p in places if p % fabric.world_size == fabric.global_rank]) for jobs, places in plans]
    total = sum(len(jobs) * len(places) for jobs, places in mine)
    with tqdm(total=total, unit="rung", leave=False, disable=fabric.global_rank > 0) as bar:
        for jobs, places in mine:
            found = sweep(model, batches.__getitem__, places, given.scene, jobs, seed=seed,
                          done=store.done() - undrawn, watch=watch)  # fmt: skip
            for i, records in enumerate(found):
                store.append(records)
                bar.set_description(jobs[i % len(jobs)].rung.title[:40])
                bar.update()


def _file(folder: Path, rung: str) -> Path:
    return folder / "pictures" / f"{hashlib.sha256(rung.encode()).hexdigest()[:16]}.png"


def _pictures(table: Table, index: Index, folder: Path, classes: Mapping[int, str], model: str) -> list[dict[str, Any]]:
    """The table's pictures of one image, each with what the model says of it: the first that it has right."""
    clean = index[CLEAN.name, MODEL.name][0]
    pairs = zip(clean["predicted"][:KEPT], clean["labels"], strict=False)
    row = next((i for i, (p, y) in enumerate(pairs) if p == y), 0)
    label, cells = clean["labels"][row], []
    for key in table.pictures:
        (rung,) = table.cells[key].rungs
        answer = index[rung.name, MODEL.name][0]["predicted"][row]
        every = np.array(Image.open(_file(folder, rung.name)))
        side = every.shape[1]
        said = [(model, words.answer(answer, classes), answer == label)]
        image = every[row * side : (row + 1) * side]
        cells.append({"title": _title(table, key), "image": image, "predictions": said})
    return [{"label": classes.get(label, str(label)), "cells": cells}] if cells else []


def _title(table: Table, key: tuple[str, str]) -> str:
    """What tells a picture from its neighbours: its row, its column, or both."""
    rows, columns = ({k[i] for k in table.pictures} for i in (0, 1))
    return ", ".join(part for part, many in zip(key, (rows, columns), strict=True) if len(many) > 1) or key[0]
