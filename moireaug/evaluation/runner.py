"""The runner: every condition shown to its classifiers, batch by batch; each finished piece is a
record."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from moireaug.attacks.checks import check_labels
from moireaug.attacks.model import class_count
from moireaug.common.networks import device_of
from moireaug.common.progress import progress_bar
from moireaug.evaluation.classifiers import UNDEFENDED, Classifier
from moireaug.evaluation.conditions import Clean, Condition, EvalBatch, Model
from moireaug.evaluation.draws import BatchDraws, restored_generators
from moireaug.evaluation.identity import identity_of
from moireaug.evaluation.keys import EvalSetup, RecordKeys
from moireaug.evaluation.loader import Batches
from moireaug.evaluation.records import Record, Records
from moireaug.evaluation.scene_batches import SceneBatches
from moireaug.evaluation.tables import Table

CLEAN = Clean()


class Job(NamedTuple):
    """One condition and all classifiers that see it."""

    condition: Condition
    classifiers: tuple[Classifier, ...]


def show_progress(jobs: Iterable[Job], total: int, title: str, *, enabled: bool) -> Iterable[Job]:
    """Show a bar of the jobs that are done."""
    with progress_bar(total=total, desc=title, unit="job", leave=False, enabled=enabled) as bar:
        for job in jobs:
            bar.set_postfix_str(job.condition.name[:30], refresh=False)
            bar.update()
            yield job


def jobs_of(tables: Iterable[Table]) -> list[Job]:
    """Return the jobs that tables need, each condition once. The clean images come first, before
    every classifier without a defence: success counts the images that it gets right.

    Raises:
        ValueError: two conditions, or two classifiers of one condition, of one name that differ.
    """
    conditions: dict[str, Condition] = {CLEAN.name: CLEAN}
    classifiers: dict[str, dict[str, Classifier]] = {CLEAN.name: {UNDEFENDED.name: UNDEFENDED}}
    for table in tables:
        for cell in table.cells:
            for condition in cell.conditions:
                first = conditions.setdefault(condition.name, condition)
                if first.settings() != condition.settings() or first.scene != condition.scene:
                    raise ValueError(
                        f"two conditions are called {condition.name!r}, and their records would "
                        f"be mixed up: {first!r} and {condition!r}. Give one another name."
                    )
                _add_classifier(cell.classifier, classifiers.setdefault(condition.name, {}))
            _add_classifier(cell.classifier.base, classifiers[CLEAN.name])
    return [Job(conditions[name], tuple(classifiers[name].values())) for name in conditions]


def _add_classifier(classifier: Classifier, classifiers: dict[str, Classifier]) -> None:
    """Add a classifier to those of a condition, by name."""
    if classifiers.setdefault(classifier.name, classifier) != classifier:
        raise ValueError(
            f"two classifiers of one condition are called {classifier.name!r}, and their records "
            "would be mixed up. Give one another name."
        )


@dataclass(frozen=True)
class _Batch:
    """Images (B, 3, H, W), their classes (B,), the classes (B,) that targeted attacks aim at, and
    the random numbers of the batch."""

    images: Tensor
    labels: Tensor
    targets: Tensor
    draws: BatchDraws


class Runner:
    """Runs jobs on one model.

    Args:
        model: function of [0, 1] images that returns logits; its state is restored.
        batches: test images.
        setup: settings that all conditions share.
        records: finished records, looked up before anything is computed.
        model_identity: identity of the model in records; None is its `identity_of`.
    """

    def __init__(
        self,
        model: Model,
        batches: Batches,
        setup: EvalSetup,
        records: Records,
        model_identity: str | None = None,
    ) -> None:
        self.model = model
        self.batches = batches
        self.setup = setup
        self.records = records
        self.model_identity = identity_of(model) if model_identity is None else model_identity
        self.device = device_of(model)
        self.keys = RecordKeys(self.model_identity, batches, setup)

    def run(self, jobs: Sequence[Job], indices: Iterable[int]) -> Iterator[Job]:
        """Run jobs on the batches of these indices; yields each job when it is done on one batch.

        Raises:
            ValueError: labels or logits that cannot be read.
        """
        for index in indices:
            images, labels = self.batches[index]
            self.keys.hash_batch(index, images, labels)
            images = images.to(self.device)
            labels = check_labels(labels, len(images), "labels").to(images.device)
            batch = None
            for job in jobs:
                classifiers = self._pending_classifiers(job, index)
                if classifiers:
                    batch = batch or self._batch(index, images, labels)
                    self.records.append(self._classify(job.condition, classifiers, batch))
                yield job

    def missing(self, jobs: Sequence[Job], indices: Iterable[int]) -> int:
        """Return how many records are missing."""
        return sum(len(self._pending_classifiers(job, index)) for index in indices for job in jobs)

    def record(self, condition: Condition, classifier: Classifier, index: int) -> Record:
        """Return the record of one condition before one classifier on one batch."""
        return self.records[self.key(condition, classifier, index)]

    def key(self, condition: Condition, classifier: Classifier, index: int) -> str:
        """Return the key of that record."""
        return self.keys.key(condition, classifier, index)

    def picture_name(self, condition: Condition) -> str:
        """Return the name of the picture of a condition."""
        return self.key(condition, UNDEFENDED, 0)

    def _pending_classifiers(self, job: Job, index: int) -> list[Classifier]:
        """Return the classifiers of a job that have no record of a batch."""
        pending = []
        for classifier in job.classifiers:
            if self.key(job.condition, classifier, index) not in self.records:
                pending.append(classifier)
        return pending

    def _batch(self, index: int, images: Tensor, labels: Tensor) -> _Batch:
        draws = BatchDraws(self.setup.seed, index)
        with restored_generators(images.device):
            classes = class_count(self.model, images, labels)
        return _Batch(images, labels, draws.targets(labels, classes), draws)

    def _scene_batches(self, condition: Condition, batch: _Batch) -> SceneBatches:
        """Return the images with their shots, a batch for each scene of a mixture."""
        generator = batch.draws.condition_generator(condition.name)
        all_rows, batches = [], []
        scene = self.setup.scene_of(condition)
        for rows, shot in batch.draws.shots(scene, batch.images):
            goals = batch.labels[rows], batch.targets[rows]
            batches.append(
                EvalBatch(
                    self.model,
                    batch.images[rows],
                    *goals,
                    shot,
                    generator,
                    lpips=self.setup.lpips,
                    bound=self.setup.bound,
                )
            )
            all_rows.append(rows)
        return SceneBatches(all_rows, batches)

    def _classify(
        self, condition: Condition, classifiers: Sequence[Classifier], batch: _Batch
    ) -> list[Record]:
        """Show the images of a condition to classifiers; return a record of each."""
        scene_batches, draws = self._scene_batches(condition, batch), batch.draws
        with restored_generators(batch.labels.device), torch.no_grad():
            draws.seed_showing(condition.name)
            start = time.perf_counter()
            images = scene_batches.show(condition)
            seconds_shown = _seconds_since(start, images.device)
            measures = scene_batches.measure(condition, images)
            records = []
            for classifier in classifiers:
                draws.seed_answers(condition.name, classifier.name)
                start = time.perf_counter()
                predictions = scene_batches.predictions(classifier, images)
                seconds = seconds_shown + _seconds_since(start, images.device)
                record = {
                    "key": self.key(condition, classifier, draws.index),
                    "model": self.model_identity,
                    "condition": condition.name,
                    "settings": condition.settings(),
                    "bound": condition.eps_unit(self.setup.bound),
                    "judge": classifier.name,
                    "batch": draws.index,
                    "labels": batch.labels.tolist(),
                    "targets": batch.targets.tolist(),
                    "predicted": predictions.tolist(),
                    "measured": measures,
                    "seconds": seconds,
                }
                records.append(record)
        if draws.index == 0:
            self.records.keep_picture(self.picture_name(condition), images)
        return records


def _seconds_since(start: float, device: torch.device) -> float:
    """Return the seconds since `start`, once the device has finished its work."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)
    return time.perf_counter() - start
