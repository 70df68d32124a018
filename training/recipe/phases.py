"""The task of recipes: the plain runs that one needs, its own training, attack and report."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from training import report
from training.attack.protocol import protocol_of
from training.attack.results import Rival, attack_and_publish, plain_metrics, run_metrics
from training.attack.subject import Subject
from training.config.checks import (
    check_answers,
    check_classifier,
    check_search,
    require_training_images,
    require_used,
)
from training.config.recipes import PLAIN_RECIPES
from training.config.schema import Adversary, Config
from training.data.load import load
from training.data.splits import Splits
from training.models.classifiers import class_count_of, class_names, require_known
from training.runs.identity import Origin
from training.runs.layout import RECORDS
from training.runs.metrics import ORIGINAL, RunMetrics, TrainCost
from training.runs.resume import damage, origin_difference
from training.runs.run import Run, baseline_of, start_of
from training.runs.task import Metrics, Task
from training.runs.trained import read_trained
from training.system import machine
from training.system.processes import is_first, print_once

if TYPE_CHECKING:
    from training.classifier.module import Classifier


class ClassificationTask(Task[Config, Splits]):
    """Answers to images: trained by a recipe, attacked, and compared with plain training."""

    def check(self, cfg: Config) -> None:
        check_classifier(cfg)
        check_search(cfg)
        if cfg.train.target == "answers":
            check_answers(cfg)
        else:
            require_training_images(cfg.data)
        require_known(cfg.model)
        if cfg.recipe in PLAIN_RECIPES and cfg.adversary != Adversary():
            raise ValueError(
                f"recipe={cfg.recipe} is plain training, which the others are compared with: leave "
                "adversary.* out."
            )
        if cfg.recipe == "clean" and cfg.train.init == "clean":
            raise ValueError(
                "train.init=clean starts from recipe clean, which has no such start itself: use "
                "random."
            )
        require_used(cfg, "adversary", "train")

    def finished(self, run: Run[Config]) -> tuple[Metrics, list[str]] | None:
        metrics = RunMetrics.read(run.folder) if run.stage() == "finished" else None
        return (metrics.to_dict(), report.run_parts(metrics)) if metrics else None

    def runs_before(self, run: Run[Config]) -> list[Run[Config]]:
        return [one for one in (start_of(run), baseline_of(run)) if one]

    def load(self, cfg: Config) -> Splits:
        return load_data(cfg)

    def try_out(self, run: Run[Config], data: Splits) -> None:
        from training.classifier.train import try_out  # Lightning, which takes seconds to import

        try_out(run, data)

    def train_and_test(self, run: Run[Config], data: Splits, data_seconds: float) -> Metrics:
        start, baseline = plain_runs(run, data)
        classifier, train = train_run(run, data, start)
        if not is_first():
            return {}
        metrics = trained_metrics(run, train, start)
        if earlier_metrics := RunMetrics.read(run.folder):  # it was trained before
            metrics = replace(metrics, environment=earlier_metrics.environment)
        seconds = {"data": data_seconds, "train": train.wall_seconds}
        return attack_run(run, data, classifier, replace(metrics, time=seconds), baseline).to_dict()


def plain_runs(run: Run[Config], splits: Splits) -> tuple[RunMetrics | None, RunMetrics | None]:
    """Return the metrics of the start and the baseline, reused or trained; None for neither."""
    start = baseline = None
    if start_run := start_of(run):
        start = plain_run(start_run, splits, None, role="start")
    if baseline_run := baseline_of(run):
        baseline = plain_run(baseline_run, splits, start, role="baseline")
    return start, baseline


def plain_run(
    run: Run[Config], splits: Splits, start: RunMetrics | None, *, role: str
) -> RunMetrics | None:
    """Return the metrics of a start or baseline: reused, or trained and not attacked; None in all
    but one process of its training.

    A damaged one is moved aside.

    Args:
        start: metrics of the run whose weights it starts from, if any.
        role: "start" or "baseline", for the messages.
    """
    with run.locked():
        origin = Origin.of(run.config.weights, splits)
        if reason := damage(run) or origin_difference(run, origin):
            print_once(f"The {role} cannot be reused and is trained again: {reason}.")
            run = Run(replace(run.config, resume=False))
        elif run.stage() in ("trained", "finished") and (metrics := RunMetrics.read(run.folder)):
            print_once(f"The {role} is reused from {run.folder}.")
            return _in_scene_of(run, metrics)
        else:
            print_once(
                f"The {role} comes first: recipe {run.config.recipe}, with the same settings."
            )
        _, train = train_run(run, splits, start)
        if not is_first():
            return None
        metrics = trained_metrics(run, train, start)
        metrics = replace(metrics, time={"train": train.wall_seconds})
        metrics.write(run.folder)
        return metrics


def _in_scene_of(run: Run[Config], metrics: RunMetrics) -> RunMetrics:
    """Return the metrics of a plain run; of one that was never attacked, and whose training has
    seen no scene, written anew for that of the runs that it is compared with."""
    wanted = run_metrics(run.config, metrics.train, metrics.start)
    if metrics.reattack is not None or metrics.scene == wanted.scene or not is_first():
        return metrics
    metrics = replace(
        wanted, environment=metrics.environment, time=metrics.time, command=metrics.command
    )
    run.write_settings()
    metrics.write(run.folder)
    return metrics


def train_run(
    run: Run[Config], splits: Splits, start: RunMetrics | None
) -> tuple[Classifier, TrainCost]:
    """Train a run in its folder, or the rest of it; see `train_model`."""
    from training.classifier.train import train_model  # Lightning, which takes seconds to import

    return train_model(run, splits, start_cost=start.train if start else None)


def trained_metrics(run: Run[Config], train: TrainCost, start: RunMetrics | None) -> RunMetrics:
    """Return the metrics of a run that was trained here, with the precision of that."""
    metrics = run_metrics(run.config, train, start.plain() if start else None)
    trainer = run.config.trainer
    precision = str(machine.precision(trainer.precision, trainer.accelerator))
    return replace(metrics, environment=metrics.environment | {"precision": precision})


def load_data(cfg: Config) -> Splits:
    """Load the data of a run. Where a network is to keep its answers, the classes are those of its
    weights."""
    splits = load(cfg.data, cfg.train.target)
    if cfg.train.target == "labels" or cfg.weights is None:
        return splits
    count = class_count_of(cfg.model, cfg.weights)
    names = class_names(cfg.model)
    if len(names) != count:
        names = {number: str(number) for number in range(count)}
    return splits._replace(classes=names, num_classes=count)


def attack_run(
    run: Run[Config],
    splits: Splits,
    classifier: Classifier,
    metrics: RunMetrics,
    baseline: RunMetrics | None,
) -> RunMetrics:
    """Attack a trained run, and what it is compared with; report, and return the metrics.

    Args:
        metrics, baseline: metrics of its training, and of its baseline.
    """
    cfg, records = run.config, run.folder / RECORDS
    original = classifier.original.model if classifier.original else None
    protocol = protocol_of(cfg, splits, original=original)
    subject = Subject(cfg.recipe, classifier.model, splits, protocol, records, run.folder, {})
    rival = None
    if original:
        rival = Rival(plain_metrics(cfg, ORIGINAL), original, records)
    elif baseline and (baseline_run := baseline_of(run)):
        # also where its records are there: a folder's images may have changed since
        trained = read_trained(baseline_run)
        rival = Rival(baseline.plain(), trained.model(), trained.folder / RECORDS)
    return attack_and_publish(subject, metrics, rival)
