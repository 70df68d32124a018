"""The runner: every condition shown to its judges, batch by batch; each finished piece is a
record."""

from __future__ import annotations

import hashlib
import time
import typing
import zlib
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from moireaug.attacks import evaluating, predicted
from moireaug.attacks.checks import check_classes, check_labels
from moireaug.evaluation.conditions import Clean, Condition, EvalBatch, Model
from moireaug.evaluation.identity import digest
from moireaug.evaluation.judges import UNDEFENDED, Judge
from moireaug.evaluation.parts import Part, joined, measured, shown_of
from moireaug.evaluation.records import Record, Records, key_of
from moireaug.evaluation.statistics import mix
from moireaug.evaluation.tables import Table
from moireaug.mixed_shot import MixedShot
from moireaug.mixtures import Mixture
from moireaug.networks import device_of
from moireaug.scenes import Scene

CLEAN = Clean()


class Batches(typing.Protocol):
    """Test images in batches, by index: (images (B, 3, H, W) in [0, 1], labels (B,))."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int) -> tuple[Tensor, Tensor]: ...


class Job(NamedTuple):
    """One condition and all judges that see it."""

    condition: Condition
    judges: tuple[Judge, ...]


def jobs_of(tables: Iterable[Table]) -> list[Job]:
    """Return the jobs that tables need, each condition once, first the clean images before every
    judge without a defence, which say which images count.

    Raises:
        ValueError: two conditions of one name that differ.
    """
    conditions: dict[str, Condition] = {CLEAN.name: CLEAN}
    judges: dict[str, dict[str, Judge]] = {CLEAN.name: {UNDEFENDED.name: UNDEFENDED}}
    for table in tables:
        for cell in table.cells:
            for condition in cell.conditions:
                known = conditions.setdefault(condition.name, condition)
                if known.settings() != condition.settings() or known.scene != condition.scene:
                    raise ValueError(
                        f"two conditions are called {condition.name!r}, and their records would "
                        f"be mixed up: {known!r} and {condition!r}. Give one another name."
                    )
                judges.setdefault(condition.name, {})[cell.judge.name] = cell.judge
            if cell.judge.base == cell.judge.name:
                judges[CLEAN.name][cell.judge.name] = cell.judge
    return [Job(conditions[name], tuple(judges[name].values())) for name in conditions]


class Runner:
    """Runs jobs on one model.

    Args:
        model: [0, 1] images to logits; its state is restored.
        batches: the test images.
        scene: one shot of it, or of one of a mixture's, is drawn per image.
        records: where finished pieces are kept; they are looked up before anything is computed.
        seed: of shots, targets, random starts and randomised judges. What is drawn depends only on
            the seed, the batch's index and the names of condition and judge, so that any process,
            now or later, draws the same.
        name: of the model in records; None is its `identity.digest`.
        lpips: a `visibility.LPIPS`, measured for every attack where given. Records with and without
            it have different keys.
    """

    def __init__(
        self,
        model: Model,
        batches: Batches,
        scene: Scene | Mixture,
        records: Records,
        *,
        seed: int = 0,
        name: str | None = None,
        lpips: nn.Module | None = None,
    ) -> None:
        self.model = model
        self.batches = batches
        self.scene = scene
        self.records = records
        self.seed = seed
        self.name = digest(model) if name is None else name
        self.lpips = lpips
        self._lpips_identity = None if lpips is None else digest(lpips)
        self.device = device_of(model)
        self._contents: dict[int, str] = {}

    def run(self, jobs: Sequence[Job], indices: Iterable[int]) -> Iterator[Job]:
        """Run jobs on the batches of these indices; yields each job when it is done on one batch.

        Raises:
            ValueError: labels or logits that cannot be read.
        """
        for index in indices:
            images, labels = self.batches[index]
            self._contents[index] = _content(images, labels)
            images = images.to(self.device)
            labels = check_labels(labels, len(images), "labels").to(images.device)
            targets = None
            for job in jobs:
                open_judges = []
                for judge in job.judges:
                    if self.key(job.condition, judge, index) not in self.records:
                        open_judges.append(judge)
                if open_judges:
                    if targets is None:
                        targets = self._targets(images, labels, index)
                    parts = self._parts(images, labels, targets, index, job.condition)
                    self.records.append(self._judged(parts, job.condition, open_judges, index))
                yield job

    def missing(self, jobs: Sequence[Job], indices: Iterable[int]) -> int:
        """Return how many records are missing."""
        count = 0
        for index in indices:
            for condition, judges in jobs:
                for judge in judges:
                    count += self.key(condition, judge, index) not in self.records
        return count

    def record(self, condition: Condition, judge: Judge, index: int) -> Record:
        """Return the record of one condition before one judge on one batch."""
        return self.records[self.key(condition, judge, index)]

    def key(self, condition: Condition, judge: Judge, index: int) -> str:
        """Return the key of that record."""
        if index not in self._contents:  # a batch that another process has done
            self._contents[index] = _content(*self.batches[index])
        batch = {"content": self._contents[index], "index": index}
        return key_of(self._meaning(condition) | {"judge": judge.identity, "batch": batch})

    def picture_name(self, condition: Condition) -> str:
        """Return the name under which what a condition shows is kept."""
        return self.key(condition, UNDEFENDED, 0)

    def _meaning(self, condition: Condition) -> dict[str, Any]:
        scene = self.scene if condition.scene is None else condition.scene
        meaning = {
            "model": self.name,
            "scene": scene.to_dict(),
            "condition": condition.settings() | {"name": condition.name},
            "seed": self.seed,
        }
        if self._lpips_identity is not None and not condition.control:
            meaning["lpips"] = self._lpips_identity
        return meaning

    def _targets(self, images: Tensor, labels: Tensor, index: int) -> Tensor:
        """Draw one of the model's other classes for each image."""
        with evaluating(self.model, images), torch.no_grad():
            logits = self.model(images[:1].clone())
        check_classes(labels[:1], logits, 1)
        classes = logits.shape[1]
        generator = torch.Generator().manual_seed(mix(self.seed, index, 1))
        offset = torch.randint(1, classes, labels.shape, generator=generator, device="cpu")
        return (labels + offset.to(labels)) % classes

    def _parts(
        self, images: Tensor, labels: Tensor, targets: Tensor, index: int, condition: Condition
    ) -> list[Part]:
        """Draw a shot for each image; a mixture's images are a batch for each of its scenes."""
        scene = self.scene if condition.scene is None else condition.scene
        draws = torch.Generator().manual_seed(mix(self.seed, index, 0))
        size = (images.shape[-2], images.shape[-1])
        shot = scene.sample(len(images), size, draws).to(images.device)
        own = torch.Generator().manual_seed(mix(self.seed, index, 2, _digits(condition.name)))
        if isinstance(shot, MixedShot):
            shots = shot.by_scene()
        else:
            shots = [(torch.arange(len(images), device=images.device), shot)]
        parts = []
        for rows, one in shots:
            given = images[rows], labels[rows], targets[rows]
            parts.append((rows, EvalBatch(self.model, *given, one, own, self.lpips)))
        return parts

    def _judged(
        self,
        parts: list[Part],
        condition: Condition,
        judges: Sequence[Judge],
        index: int,
    ) -> list[Record]:
        labels = joined(parts, lambda rows, part: part.labels)
        targets = joined(parts, lambda rows, part: part.targets)
        # a randomised model or defence draws from the global generator: the same numbers
        # wherever this piece is computed
        devices = [labels.device] if labels.is_cuda else []
        with torch.random.fork_rng(devices), torch.no_grad():
            torch.manual_seed(mix(self.seed, index, 3, _digits(condition.name)))
            start = time.perf_counter()
            shown = joined(parts, lambda rows, part: shown_of(condition, part))
            seconds_shown = _wait(shown, start)
            figures = measured(condition, parts, shown)
            found = []
            for judge in judges:
                both = (_digits(condition.name), _digits(judge.name))
                torch.manual_seed(mix(self.seed, index, 4, *both))
                start = time.perf_counter()
                logits = joined(parts, partial(_logits, judge, shown))
                check_classes(labels, logits, 1)
                answers = predicted(logits).tolist()  # which waits for the device
                seconds = seconds_shown + time.perf_counter() - start
                record = self._record(condition, judge, index)
                record |= {"labels": labels.tolist(), "targets": targets.tolist()}
                record |= {"predicted": answers, "measured": figures, "seconds": seconds}
                found.append(record)
        if index == 0:
            self.records.keep_picture(self.picture_name(condition), shown)
        return found

    def _record(self, condition: Condition, judge: Judge, index: int) -> Record:
        return {
            "key": self.key(condition, judge, index),
            "model": self.name,
            "condition": condition.name,
            "settings": condition.settings(),
            "judge": judge.name,
            "batch": index,
        }


def _logits(judge: Judge, shown: Tensor, rows: Tensor, part: EvalBatch) -> Tensor:
    return judge.logits(part, shown[rows])


def _content(images: Tensor, labels: Tensor) -> str:
    sums = hashlib.sha256(images.detach().cpu().contiguous().numpy().tobytes())
    sums.update(str(labels.tolist()).encode())
    return sums.hexdigest()[:16]


def _wait(shown: Tensor, start: float) -> float:
    if shown.is_cuda:
        torch.cuda.synchronize()
    return time.perf_counter() - start


def _digits(name: str) -> int:
    """Return a number for a name, the same on every machine."""
    return zlib.crc32(name.encode())
