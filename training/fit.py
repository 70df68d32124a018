"""Train a classifier against the Moiré Attack, attack it again, and report what was gained and what it cost.

    python training/fit.py recipe=moire_at
    python training/fit.py -m recipe=clean,moire_at seed=0,1
    python training/fit.py recipe=moire_fast data=folder data.root=DIR train.epochs=30

Recipes: recipes/*.yaml. Settings: training/schema.py. A run writes runs/<recipe>/seed<k>/ with report.html,
metrics.json, best.ckpt, last.ckpt and config.yaml. Its baseline, recipe `clean` with the same settings, is trained
first, or reused where it was trained before.
"""

from __future__ import annotations

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
from lightning.pytorch.callbacks import EMAWeightAveraging, ModelCheckpoint, TQDMProgressBar
from lightning.pytorch.utilities import rank_zero_only
from omegaconf import DictConfig, OmegaConf

from moireaug.evaluation.store import write_text
from moireaug.fields import one_of
from training import runs
from training.adversaries import passes
from training.batches import Batches
from training.classifier import Classifier
from training.data import Splits, load
from training.guard import Guard
from training.reattack import attack_again, check, describe, from_run, publish
from training.schema import Config, check_keys, register


def fit(cfg: DictConfig) -> dict[str, Any]:
    """Train, attack again, report: one run. Returns its metrics."""
    check(cfg)
    out, mark = runs.folder(cfg), runs.fingerprint(runs.settings(cfg))
    twin = None if cfg.recipe == "clean" else runs.plain_twin(cfg)
    baseline = trained_twin(twin, resume=cfg.resume) if twin else None

    began = time.perf_counter()
    splits = load(cfg.data)
    seconds = {"data": time.perf_counter() - began}
    # an interruption may have come while the baseline was trained: then this run begins
    cfg.resume = cfg.resume and (twin is None or (out / "last.ckpt").is_file())
    if rank_zero_only.rank == 0:
        runs.prepare(out, mark, resume=cfg.resume)
    model, train = train_model(cfg, splits, out, start=runs.folder(twin) if twin else None)
    seconds["train"] = train["wall_seconds"]
    if rank_zero_only.rank != 0:
        return {}

    began = time.perf_counter()
    try:
        rows = attack_again(model, splits, cfg, title=cfg.recipe)
    except KeyboardInterrupt:
        print(f"\nInterrupted after training. The model is whole in {out / 'best.ckpt'}; go on with\n  {again()}")
        raise SystemExit(130) from None
    seconds["re-attack"] = time.perf_counter() - began
    return publish(out, cfg, model, splits, rows, train=train, baseline=baseline, seconds=seconds)


def trained_twin(twin: DictConfig, *, resume: bool) -> dict[str, Any]:
    """The baseline's metrics: from `runs/` where it was trained with the same settings before, else from training.
    Where only the re-attack's settings differ, the weights that are there are attacked again."""
    out = runs.folder(twin)
    known = runs.read_metrics(out)
    say = rank_zero_only(print)
    if known and (out / "best.ckpt").is_file():
        before, now = known.get("config") or {}, runs.settings(twin)
        if before == now:
            say(f"The baseline is reused from {out}.")
            return known
        if before | {"reattack": None} == now | {"reattack": None}:
            say(f"The baseline's weights are reused from {out} and attacked again: reattack.* has changed.")
            if rank_zero_only.rank != 0:
                return known
            return known | describe(attack_again(from_run(out)[0], load(twin.data), twin, title="clean"))
    say("The baseline comes first: recipe clean, with the same settings.")
    twin.resume = resume and (out / "last.ckpt").is_file()
    return fit(twin)


def again() -> str:
    """The command that goes on with this run."""
    return f"{runs.command([a for a in sys.argv if not a.startswith('resume=')])} resume=true"


def train_model(cfg: DictConfig, splits: Splits, out: Path, *, start: Path | None) -> tuple[Classifier, dict[str, Any]]:
    """Train and return the averaged weights that did best on validation, with what it cost.

    Args:
        start: the folder of the baseline, whose weights `train.init=clean` begins with.
    """
    L.seed_everything(cfg.seed, verbose=False)
    last = out / "last.ckpt"
    classifier = Classifier(cfg, splits.num_classes)
    if one_of("train.init", cfg.train.init, ("random", "clean")) == "clean":
        if start is None:
            raise ValueError("train.init=clean starts from recipe clean, which has no such start itself: use random.")
        classifier.load_state_dict(runs.read_checkpoint(start / "best.ckpt")["state_dict"])
    if cfg.resume:
        runs.read_checkpoint(last)
    if rank_zero_only.rank == 0:
        write_text(out / "config.yaml", OmegaConf.to_yaml(cfg, resolve=True))
    keep = {"dirpath": out, "enable_version_counter": False}
    best = ModelCheckpoint(filename="best", monitor="val_score", mode="max", **keep)
    callbacks = [
        EMAWeightAveraging(decay=cfg.train.ema),
        best,
        Guard(out / "best.ckpt"),
        ModelCheckpoint(filename="last", save_on_train_epoch_end=True, **keep),
        TQDMProgressBar(leave=False),
    ]
    settings = OmegaConf.to_container(cfg.trainer)
    if settings["accelerator"] == "auto" and not torch.cuda.is_available():
        settings["accelerator"] = "cpu"  # Apple's GPUs have no float64, which the geometry needs
    trainer = L.Trainer(
        **settings,  # type: ignore[arg-type]
        max_epochs=cfg.train.epochs, callbacks=callbacks, logger=False, num_sanity_val_steps=0,
        enable_model_summary=False, use_distributed_sampler=False, benchmark=False,
    )  # fmt: skip
    began = time.perf_counter()
    say = rank_zero_only(print)
    say(f"Training {cfg.model} on {cfg.data.name}, recipe {cfg.recipe}, {cfg.train.epochs} epochs")
    try:
        trainer.fit(classifier, Batches(cfg, splits), ckpt_path=str(last) if cfg.resume else None)
    except (SystemExit, KeyboardInterrupt):
        if last.is_file():
            say(f"\nInterrupted. Every whole epoch is kept in {last}; go on with\n  {again()}")
        else:
            say("\nInterrupted before the first epoch was over: nothing was kept.")
        raise SystemExit(130) from None
    spent = sum(h["seconds"] for h in classifier.history)
    state = runs.read_checkpoint(out / "best.ckpt")
    classifier.load_state_dict(state["state_dict"])
    return classifier.eval(), {
        "seconds": spent,
        "wall_seconds": time.perf_counter() - began,
        "epochs": len(classifier.history),
        "best_epoch": int(state["epoch"]),
        "images_per_second": len(splits.train) * len(classifier.history) / max(spent, 1e-9),  # type: ignore[arg-type]
        "init": cfg.train.init,
        "passes": passes(cfg.adversary),
        "collapsed_at": classifier.collapsed_at,
        "history": classifier.history,
    }


@hydra.main(version_base="1.3", config_path=None, config_name="root")
def main(cfg: DictConfig) -> None:
    quiet()
    try:
        fit(cfg)
    except (ValueError, TypeError, FloatingPointError) as error:
        raise SystemExit(f"error: {error}") from None


def quiet() -> None:
    """What Lightning says at every start, and a user of these recipes has no use for, stays unsaid."""
    for name in ("lightning.pytorch", "lightning.fabric", "lightning"):
        logging.getLogger(name).setLevel(logging.WARNING)
    warnings.filterwarnings("ignore", ".*does not have many workers.*")
    warnings.filterwarnings("ignore", ".*Checkpoint directory .* exists and is not empty.*")
    warnings.filterwarnings("ignore", ".*smaller than the logging interval.*")
    warnings.filterwarnings("ignore", ".*isinstance.treespec, LeafSpec.*")  # Lightning's own, on newer torch


register()
if __name__ == "__main__":
    check_keys(sys.argv[1:], Config)
    main()
