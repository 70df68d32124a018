"""Train a classifier against the Moiré Attack, attack it again, and report what was gained and what it cost.

    python training/fit.py recipe=moire_at
    python training/fit.py -m recipe=clean,moire_at seed=0,1
    python training/fit.py recipe=moire_fast data=folder data.root=DIR train.epochs=30

Recipes: recipes/*.yaml. Settings: training/schema.py. A run writes runs/<recipe>/seed<k>/ with report.html,
metrics.json, best.ckpt, last.ckpt and config.yaml; with other data or another model than the default the folder is
runs/<data>-<model>/<recipe>/seed<k>/. Its baseline, recipe `clean` with the same settings, is trained first, or reused
where it was trained before. A run that was cut short, however it was, goes on when the same command is given again.
"""

from __future__ import annotations

import json
import logging
import sys
import time
import warnings
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

import hydra
import lightning as L
import torch
from lightning.pytorch.callbacks import TQDMProgressBar
from lightning.pytorch.plugins.environments import SLURMEnvironment, TorchElasticEnvironment
from lightning.pytorch.utilities import rank_zero_only
from omegaconf import DictConfig, OmegaConf

from moireaug.evaluation import report
from moireaug.evaluation.store import write_text
from moireaug.scene.fields import one_of
from training import adversaries, commands, ranks, reattack, runs, saved
from training.adversaries import passes
from training.batches import Batches
from training.checkpoints import Keep, Names, WholeFiles
from training.classifier import Classifier
from training.data import Splits, load
from training.guard import Guard
from training.reattack import attack_again, describe, publish
from training.schema import Config, register
from training.tuning import averaging, tuning


def fit(cfg: DictConfig) -> dict[str, Any]:
    """Train, attack again, report: one run, or what is left of it. Returns its metrics."""
    check(cfg)
    out = runs.folder(cfg)
    if rank_zero_only.rank == 0:
        runs.make(out)
    with runs.held(out):
        if cfg.resume is not False and runs.stage(cfg) == "finished":
            print(report.summary(known := runs.read_metrics(out)))
            print(f"{out} is already finished; resume=false trains it again.")
            return known
        return _fit(cfg, out)


def check(cfg: DictConfig) -> None:
    """Refuse settings before any time is spent.

    Raises:
        TypeError, ValueError: with what was got and what is allowed.
    """
    reattack.check(cfg)
    adversaries.check(cfg.adversary)
    one_of("train.init", cfg.train.init, ("random", "clean"))


def _fit(cfg: DictConfig, out: Path) -> dict[str, Any]:
    twin = None if cfg.recipe == "clean" else runs.plain_twin(cfg)
    if cfg.resume and rank_zero_only.rank == 0:
        runs.insist(cfg, *([twin] if twin else []))
    baseline, beside = None, None
    if twin:
        baseline = trained_twin(twin)
        beside = saved.read(runs.folder(twin)).model() if rank_zero_only.rank == 0 else None

    began = time.perf_counter()
    splits = load(cfg.data)
    seconds = {"data": time.perf_counter() - began}
    if rank_zero_only.rank == 0:
        runs.prepare(cfg)
    model, train = train_model(cfg, splits, out, start=runs.folder(twin) if twin else None)
    seconds["train"] = train["wall_seconds"]
    if rank_zero_only.rank != 0:
        return {}

    began = time.perf_counter()
    rows = attack_again(model, splits, cfg, title=cfg.recipe)
    seconds["re-attack"] = time.perf_counter() - began
    metrics = publish(out, cfg, model, splits, rows, train=train, baseline=baseline, beside=beside, seconds=seconds)
    (out / "train.json").unlink(missing_ok=True)  # metrics.json holds it
    return metrics


def trained_twin(twin: DictConfig) -> dict[str, Any]:
    """The baseline's metrics: from `runs/` where it was trained with the same settings before, else from training.
    Where only the re-attack's settings differ, the weights that are there are attacked again. Damaged ones are moved
    aside."""
    out = runs.folder(twin)
    known = runs.read_metrics(out)
    say = rank_zero_only(print)
    if damage := saved.damage(twin):
        say(f"The baseline is damaged and trained again: {damage}.")
        return fit(OmegaConf.merge(twin, {"resume": False}))
    if known and (out / "best.ckpt").is_file():
        before, now = known.get("config") or {}, runs.settings(twin)
        if before == now:
            say(f"The baseline is reused from {out}.")
            return known
        if before | {"reattack": None} == now | {"reattack": None}:
            say(f"The baseline's weights are reused from {out} and attacked again: reattack.* has changed.")
            if rank_zero_only.rank != 0:
                return known
            return known | describe(attack_again(saved.read(out).model(), load(twin.data), twin, title="clean"))
    say("The baseline comes first: recipe clean, with the same settings.")
    return fit(twin)


def train_model(cfg: DictConfig, splits: Splits, out: Path, *, start: Path | None) -> tuple[Classifier, dict[str, Any]]:
    """Train and return the averaged weights that did best on validation, with what it cost.

    Args:
        start: the folder of the baseline, whose weights `train.init=clean` begins with.
    """
    L.seed_everything(cfg.seed, verbose=False)
    last, best, told = out / "last.ckpt", out / "best.ckpt", out / "train.json"
    classifier = Classifier(cfg, splits.num_classes)
    resume = runs.goes_on(cfg)
    if resume and (train := runs.read_json(told)):
        classifier.load_state_dict(runs.read_checkpoint(best)["state_dict"])
        print(f"Training is over: the weights are those of {best}.")
        return classifier.eval(), train
    if cfg.train.init == "clean":
        if start is None:
            raise ValueError("train.init=clean starts from recipe clean, which has no such start itself: use random.")
        classifier.load_state_dict(runs.read_checkpoint(start / "best.ckpt")["state_dict"])
    before = runs.read_checkpoint(last)["history"] if resume else []
    if rank_zero_only.rank == 0:
        write_text(out / "config.yaml", OmegaConf.to_yaml(cfg, resolve=True))
    trainer, batches = trainer_of(cfg, out, splits.classes), Batches(cfg, splits, first=len(before))
    began = time.perf_counter()
    say = rank_zero_only(print)
    what = f"Training {cfg.model} on {cfg.data.name}, recipe {cfg.recipe}"
    say(f"{what}, {cfg.train.epochs} epochs, lr {tuning(cfg).lr:g}")
    if before:
        say(f"{len(before)} of them are over: {last} is gone on from.")
    try:
        with ranks.together(trainer):
            trainer.fit(classifier, batches, ckpt_path=str(last) if resume else None)
    except SystemExit:  # what Lightning makes of Ctrl-C and of SIGTERM
        raise KeyboardInterrupt from None
    spent = sum(h["seconds"] for h in classifier.history)
    state = runs.read_checkpoint(best)
    classifier.load_state_dict(state["state_dict"])
    train = {
        "seconds": spent,
        "wall_seconds": time.perf_counter() - began + sum(h["seconds"] + h["validation_seconds"] for h in before),
        "epochs": len(classifier.history),
        "best_epoch": int(state["epoch"]),
        "images_per_second": len(splits.train) * len(classifier.history) / max(spent, 1e-9),  # type: ignore[arg-type]
        "init": cfg.train.init,
        "passes": passes(cfg.adversary),
        "collapsed_at": classifier.collapsed_at,
        "history": classifier.history,
    }
    if rank_zero_only.rank == 0:
        write_text(told, json.dumps(train))
    return classifier.eval(), train


def trainer_of(cfg: DictConfig, out: Path, classes: dict[int, str]) -> L.Trainer:
    """Lightning's trainer, which keeps best.ckpt and last.ckpt in the run's folder."""
    settings = OmegaConf.to_container(cfg.trainer)
    if settings["accelerator"] == "auto" and not torch.cuda.is_available():
        settings["accelerator"] = "cpu"  # Apple's GPUs have no float64, which the geometry needs
    plugins: list[Any] = [WholeFiles()]
    if SLURMEnvironment.detect() and not TorchElasticEnvironment.detect():
        plugins.append(SLURMEnvironment(auto_requeue=False))  # the same command goes on by itself
    best = Keep(out, "best", monitor="val_score", mode="max")
    callbacks = [
        averaging(tuning(cfg)), best, Guard(out / "best.ckpt"), Keep(out, "last"), Names(classes),
        TQDMProgressBar(leave=False),
    ]  # fmt: skip
    return L.Trainer(
        **settings,  # type: ignore[arg-type]
        max_epochs=cfg.train.epochs, callbacks=callbacks, plugins=plugins, logger=False, num_sanity_val_steps=0,
        enable_model_summary=False, use_distributed_sampler=False, benchmark=False,
    )  # fmt: skip


@hydra.main(version_base="1.3", config_path=None, config_name="root")
def main(cfg: DictConfig) -> None:
    quiet()
    with commands.sentences(kept="Every whole epoch is kept"):
        fit(cfg)


def quiet() -> None:
    """What Lightning says at every start, and a user of these recipes has no use for, stays unsaid."""
    for name in ("lightning.pytorch", "lightning.fabric", "lightning"):
        logging.getLogger(name).setLevel(logging.WARNING)
    warnings.filterwarnings("ignore", ".*does not have many workers.*")
    warnings.filterwarnings("ignore", ".*in eval mode at the start of training.*")  # what fine-tuning keeps
    warnings.filterwarnings("ignore", ".*Checkpoint directory .* exists and is not empty.*")
    warnings.filterwarnings("ignore", ".*sync_dist=True.*")  # what is logged is the mean of all devices already
    warnings.filterwarnings("ignore", ".*smaller than the logging interval.*")
    warnings.filterwarnings("ignore", ".*isinstance.treespec, LeafSpec.*")  # Lightning's own, on newer torch


register()
if __name__ == "__main__":
    commands.run(main, Config)
