"""The runner: every condition shown to its classifiers, batch by batch; each finished piece is a
record."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import torch
from torch import Tensor

from moireaug.attacks.checks import check_labels
from moireaug.attacks.model import class_count
from moireaug.common.image_checks import check_images
from moireaug.common.networks import device_of, in_evaluation_mode
from moireaug.common.progress import progress_bar
from moireaug.evaluation.batches import (
    ANSWER_STREAM,
    CONDITION_STREAM,
    SHOW_STREAM,
    Batches,
    SeededBatch,
    restored_generators,
)
from moireaug.evaluation.classifiers import UNDEFENDED, Classifier, within_memory
from moireaug.evaluation.conditions import FRAME_COLUMNS, Clean, Condition, EvalBatch, Model
from moireaug.evaluation.identity import identity_of
from moireaug.evaluation.records import EvalSetup, Record, Records, batch_digest, key_of
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
                if _identity_in_records(first) != _identity_in_records(condition):
                    raise ValueError(
                        f"two conditions are called {condition.name!r}, and their records would "
                        f"be mixed up: {first!r} and {condition!r}. Give one another name."
                    )
                _add_classifier(cell.classifier, classifiers.setdefault(condition.name, {}))
            _add_classifier(cell.classifier.base, classifiers[CLEAN.name])
    return [Job(conditions[name], tuple(classifiers[name].values())) for name in conditions]


def _identity_in_records(condition: Condition) -> tuple[Any, ...]:
    return type(condition), condition.settings(), condition.scene


def _add_classifier(classifier: Classifier, classifiers: dict[str, Classifier]) -> None:
    """Add a classifier to those of a condition, by name."""
    if classifiers.setdefault(classifier.name, classifier) != classifier:
        raise ValueError(
            f"two classifiers of one condition are called {classifier.name!r}, and their records "
            "would be mixed up. Give one another name."
        )


@dataclass(eq=False)
class Runner:
    """Runs jobs on one model.

    Args:
        model: function of [0, 1] images that returns logits; its state is restored.
        batches: test images.
        setup: settings that all conditions share.
        records: finished records, looked up before anything is computed.
        model_identity: identity of the model in records; by default its `identity_of`.
    """

    model: Model
    batches: Batches
    setup: EvalSetup
    records: Records
    model_identity: str = ""

    def __post_init__(self) -> None:
        self.model_identity = self.model_identity or identity_of(self.model)
        self.device = device_of(self.model)
        self._digests: dict[int, str] = {}  # of batches

    def run(self, jobs: Sequence[Job], indices: Iterable[int]) -> Iterator[Job]:
        """Run jobs on the batches of these indices; yields each job when it is done on one batch.

        Raises:
            ValueError: labels or logits that cannot be read.
        """
        for index in indices:
            images, labels = self.batches[index]
            self._digests[index] = batch_digest(images, labels)
            images = images.to(self.device)
            labels = check_labels(labels, len(images), "labels").to(images.device)
            batch = None
            for job in jobs:
                classifiers = self._pending_classifiers(job, index)
                if classifiers:
                    if batch is None:
                        with restored_generators():
                            classes = class_count(self.model, images, labels)
                        batch = SeededBatch(self.setup.seed, index, images, labels, classes)
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
        if index not in self._digests:  # a batch that another process has done
            self._digests[index] = batch_digest(*self.batches[index])
        fields = self.setup.key_fields(condition) | {"model": self.model_identity}
        fields |= {"judge": classifier.identity}
        fields |= {"batch": {"content": self._digests[index], "index": index}}
        return key_of(fields)

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

    def _classify(
        self, condition: Condition, classifiers: Sequence[Classifier], batch: SeededBatch
    ) -> list[Record]:
        """Show the images of a condition to classifiers; return a record of each."""
        whole = EvalBatch(
            model=self.model,
            images=batch.images,
            labels=batch.labels,
            targets=batch.targets,
            shot=batch.shot(self.setup.scene_of(condition)),
            generator=batch.generator(CONDITION_STREAM, condition.name),
            lpips=self.setup.lpips_of(condition),
            bound=self.setup.bound,
        )
        with restored_generators(), torch.no_grad():
            torch.manual_seed(batch.seed_of(SHOW_STREAM, condition.name))
            start = time.perf_counter()
            with in_evaluation_mode(self.model):  # a condition of one's own may ask it
                images = whole.in_scenes(partial(within_memory, partial(_shown, condition)))
                seconds_shown = _seconds_since(start, images.device)
                measure = partial(within_memory, partial(_measured, condition))
                measured = whole.in_scenes(measure, images, join=_by_name)
            records = []
            for classifier in classifiers:
                torch.manual_seed(batch.seed_of(ANSWER_STREAM, condition.name, classifier.name))
                start = time.perf_counter()
                predict = partial(within_memory, classifier.predictions)
                predicted = whole.in_scenes(predict, images)
                seconds = seconds_shown + _seconds_since(start, images.device)
                record = {
                    "key": self.key(condition, classifier, batch.index),
                    "model": self.model_identity,
                    "condition": condition.name,
                    "settings": condition.settings(),
                    "bound": condition.eps_unit(self.setup.bound),
                    "judge": classifier.name,
                    "batch": batch.index,
                    "labels": batch.labels.tolist(),
                    "targets": batch.targets.tolist(),
                    "predicted": predicted.tolist(),
                    "measured": measured,
                    "seconds": seconds,
                }
                records.append(record)
        if batch.index == 0:
            self.records.keep_picture(self.picture_name(condition), images)
        return records


def _shown(condition: Condition, batch: EvalBatch) -> Tensor:
    """Return the images (B, 3, H, W) that a condition shows, clipped to [0, 1]. No model is asked
    about what is no image: TypeError, ValueError."""
    images = condition.show(_copy_of(batch))
    try:
        images = check_images(images)
    except (TypeError, ValueError) as error:
        raise type(error)(f"what the condition {condition.name!r} shows: {error}") from None
    if len(images) != len(batch.images):
        raise ValueError(
            f"the condition {condition.name!r} must show one image for each of the batch's "
            f"{len(batch.images)}; got {len(images)}."
        )
    return images


def _measured(condition: Condition, batch: EvalBatch, images: Tensor) -> dict[str, list[float]]:
    """Return what a condition measures of its images. A figure that is not of each image, or that
    would hide one of the evaluation's own, is refused: ValueError."""
    figures = {}
    for name, values in condition.measure(_copy_of(batch), images.clone()).items():
        try:
            values = values.tolist() if hasattr(values, "tolist") else values
            figures[name] = [float(value) for value in values]  # JSON has no other numbers
        except (TypeError, ValueError, RuntimeError):
            figures[name] = []
        if name in FRAME_COLUMNS or len(figures[name]) != len(images):
            raise ValueError(
                f"the condition {condition.name!r} must measure a number of each of the "
                f"{len(images)} images, by a name that is none of {', '.join(FRAME_COLUMNS)}; got "
                f"{len(figures[name])} numbers as {name!r}."
            )
    return figures


def _copy_of(batch: EvalBatch) -> EvalBatch:
    """Return a batch for a condition, which may work in place."""
    images, labels, targets = batch.images.clone(), batch.labels.clone(), batch.targets.clone()
    return replace(batch, images=images, labels=labels, targets=targets)


def _by_name(
    rows: Sequence[Tensor], parts: Sequence[Mapping[str, list[float]]]
) -> dict[str, list[float]]:
    """Return the figures of the images in each scene by name, in the order of the batch."""
    order = torch.cat(list(rows)).argsort().tolist()
    figures = {}
    for name in parts[0]:
        values = list(itertools.chain.from_iterable(part[name] for part in parts))
        figures[name] = [values[place] for place in order]
    return figures


def _seconds_since(start: float, device: torch.device) -> float:
    """Return the seconds since `start`, once the device has finished its work."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)
    return time.perf_counter() - start
