"""Training of a classifier: its batches, its trainer, its first weights and its cost."""

from collections.abc import Mapping
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import lightning as L

from moireaug.common.weights import write_tensors
from moireaug.scene.draws import mix_seeds
from training.classifier.adversaries import passes, require_parts
from training.classifier.guard import CollapseGuard, note_late_collapse
from training.classifier.module import Classifier
from training.classifier.original import Blend, Original, keep_answers
from training.classifier.tuning import Tuning, weight_averaging
from training.config.scenes import scene_of
from training.config.schema import Config, Trainer
from training.data.batches import Batches, require_even
from training.data.splits import Splits
from training.models.classifiers import as_model, check_side
from training.runs.identity import Origin
from training.runs.layout import BEST
from training.runs.metrics import TrainCost
from training.runs.run import Run, start_of
from training.runs.trained import read_trained
from training.system import machine
from training.system.messages import count_text
from training.system.processes import is_first, print_once
from training.trainer.make import make_trainer
from training.trainer.train import train


def try_out(run: Run[Config], splits: Splits) -> None:
    """Make the model and the trainer once, show the model a picture, and read an image of each
    part, before any run is moved or any time is spent."""
    cfg = run.config
    if splits.num_classes < 2:
        raise ValueError(
            f"the data hold a single class, {splits.classes[0]!r}: a classifier needs two."
        )
    classifier = classifier_of(cfg, splits.num_classes)
    check_side(classifier.model, cfg.model, cfg.data.size)
    trainer = trainer_of(cfg.trainer, classifier.tuning, 1, run.folder, Origin())
    require_even(cfg.train.batch_size, trainer.world_size)
    batch_size = min(cfg.train.batch_size, len(splits.train))  # type: ignore[arg-type]
    require_parts(cfg.adversary, max(1, batch_size // trainer.world_size))
    for part in (splits.train, splits.val, splits.test):
        _ = part[0]  # raises where it cannot be read


def train_model(
    run: Run[Config],
    splits: Splits,
    start_cost: TrainCost | None = None,
    classifier: Classifier | None = None,
) -> tuple[Classifier, TrainCost]:
    """Train, and return the averaged weights that did best on validation, and the cost.

    Args:
        start_cost: cost of the run whose weights it starts from, for the totals.
        classifier: to train in place of the settings' own, such as one with another adversary.

    Raises: as `training.trainer.train.train`.
    """
    cfg = run.config
    L.seed_everything(cfg.seed, verbose=False)
    classifier = classifier or classifier_of(cfg, splits.num_classes)
    start = start_of(run)
    if start and not run.can_resume():
        classifier.model.load_state_dict(read_trained(start).state)
    epochs = max(1, round(cfg.train.length * cfg.train.epochs))
    origin = Origin.of(cfg.weights, splits)
    trainer = trainer_of(cfg.trainer, classifier.tuning, epochs, run.folder, origin)

    def finish(best: Mapping[str, Any], seconds: float) -> dict[str, Any]:
        note_late_collapse(classifier, int(best["epoch"]))
        shares = {}
        if classifier.original:
            path = run.folder / BEST
            shares = blend_best(classifier, classifier.original, splits, best, path)._asdict()
        # an incomplete last batch is left out of an epoch
        epoch_images = int(trainer.num_training_batches) * cfg.train.batch_size
        images = min(len(splits.train), epoch_images)  # type: ignore[arg-type]
        whole_cost = TrainCost(
            **cost_of(cfg, classifier, images, start_cost),
            wall_seconds=seconds,
            best_epoch=int(best["epoch"]),
            **shares,
        )
        return asdict(whole_cost)

    batches_from = partial(
        Batches,
        splits,
        cfg.train.batch_size,
        workers=cfg.data.workers,
        seed=seed_of_draws(cfg),
    )
    plan = _plan_line(cfg, epochs, classifier.tuning.lr, start_cost)
    cost = train(run, classifier, trainer, batches_from, finish, plan)
    return classifier.eval(), TrainCost.of(cost, run.folder)


def cost_of(
    cfg: Config, classifier: Classifier, images: int, start_cost: TrainCost | None
) -> dict[str, Any]:
    """Return the fields of `TrainCost` that the history of a training holds.

    Args:
        images: number of images of an epoch.
    """
    epochs = len(classifier.history)
    seconds = sum(epoch["seconds"] for epoch in classifier.history)
    return {
        "init": cfg.train.init,
        "passes": mean_passes(cfg, classifier),
        "seconds": seconds,
        "epochs": epochs,
        "images_per_second": images * epochs / max(seconds, 1e-9),
        "collapsed_at": classifier.collapsed_at,
        "history": classifier.history,
        "total_epochs": epochs + (start_cost.epochs if start_cost else 0),
        "total_seconds": seconds + (start_cost.seconds if start_cost else 0.0),
    }


def mean_passes(cfg: Config, classifier: Classifier) -> float:
    """Return the passes per image, the mean over all epochs: after a collapse they are more."""
    own = passes(cfg.adversary, cfg.train.target)
    if classifier.collapsed_at is None:
        return own
    epochs = len(classifier.history)
    harder_share = (epochs - 1 - classifier.collapsed_at) / epochs
    harder = passes(classifier.adversary.cfg, cfg.train.target)
    return (1 - harder_share) * own + harder_share * harder


def blend_best(
    classifier: Classifier,
    original: Original,
    splits: Splits,
    checkpoint: Mapping[str, Any],
    path: Path,
) -> Blend:
    """Move the best weights towards the original's, as `keep_answers`, and write them; return their
    shares."""
    if "new_share" in checkpoint:  # by a command that was interrupted after it
        return Blend(checkpoint["new_share"], checkpoint["equal_answers"])
    kept = classifier.train_cfg.kept
    blend = keep_answers(classifier.model, original, splits.val, kept)
    share, equal = blend
    print_once(
        f"Weights: {share:.0%} new, {1 - share:.0%} the original's; {equal:.1%} of the validation "
        "images are answered as before."
    )
    if equal < kept:
        print_once(
            f"warning: that is less than train.kept={kept:g}, which no average of the weights had: "
            "train with a smaller train.lr, fewer train.epochs, or more pictures."
        )
    if is_first():
        state = {"state_dict": classifier.state_dict()}
        blended = {**checkpoint, **blend._asdict(), **state}
        write_tensors(path, blended)
    return blend


def _plan_line(cfg: Config, epochs: int, lr: float, start_cost: TrainCost | None) -> str:
    """Return a line on the training that begins."""
    plan = count_text(epochs, "epoch")
    if start_cost:
        plan += f" after the {start_cost.epochs} of its start"
    return f"Training {cfg.model} on {cfg.data.name}, recipe {cfg.recipe}: {plan}, lr {lr:g}"


def classifier_of(cfg: Config, num_classes: int) -> Classifier:
    """Return the classifier of these settings, with random weights or those of `weights=`."""
    return Classifier(
        as_model(cfg.model, num_classes, cfg.weights, whole=cfg.train.target == "answers"),
        cfg.train,
        cfg.adversary,
        scene_of(cfg),
        seed=seed_of_draws(cfg),
        augment=cfg.data.augment,
        fine=cfg.weights is not None,
    )


def seed_of_draws(cfg: Config) -> int:
    """Return the seed of the batches and of all draws in them.

    It is far from that of the start, whose epochs would be repeated otherwise: a sampler's order in
    epoch e is that of seed + e."""
    return mix_seeds(cfg.seed, int(cfg.train.init == "clean"), 0)


def trainer_of(
    settings: Trainer, tuning: Tuning, epochs: int, folder: Path, origin: Origin
) -> L.Trainer:
    """Return Lightning's trainer of a classifier in a run's folder."""
    precision = machine.precision(settings.precision, settings.accelerator)
    settings = replace(settings, precision=precision)
    callbacks = [weight_averaging(tuning), CollapseGuard(folder / BEST)]
    return make_trainer(settings, epochs, folder, origin, "val_score", callbacks, tuning.clip)
