"""The runner: every condition shown to its judges, batch by batch; each finished piece is a
record."""

from __future__ import annotations

import hashlib
import time
import typing
import zlib
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from moireaug.attacks import evaluating, predicted
from moireaug.attacks.checks import check_classes, check_labels
from moireaug.evaluation.conditions import Clean, Condition, EvalBatch, Model
from moireaug.evaluation.identity import identity
from moireaug.evaluation.judges import UNDEFENDED, Judge
from moireaug.evaluation.records import Record, Records, key_of
from moireaug.evaluation.scene_batches import SceneBatches
from moireaug.evaluation.statistics import mix_seeds
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
    """Return the jobs that tables need, each condition once. The clean images come first, before
    every judge without a defence: success counts the images that it gets right.

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
            base = cell.judge.base
            judges[CLEAN.name][base.name] = base
    return [Job(conditions[name], tuple(judges[name].values())) for name in conditions]


class Runner:
    """Runs jobs on one model.

    Args:
        model: function of [0, 1] images that returns logits; its state is restored.
        batches: test images.
        scene: scene, or mixture of scenes, of which one shot is drawn per image.
        records: finished records, looked up before anything is computed.
        seed: seed of shots, targets, random starts and randomised judges. Draws depend only on the
            seed, the batch's index and the names of condition and judge, so that any process, now
            or later, draws the same.
        name: name of the model in records; None is its `identity`.
        lpips: `visibility.LPIPS` to measure every attack with, or None. Records with and without it
            have different keys.
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
        self.name = identity(model) if name is None else name
        self.lpips = lpips
        self._lpips_identity = None if lpips is None else identity(lpips)
        self.device = device_of(model)
        self._batch_digests: dict[int, str] = {}

    def run(self, jobs: Sequence[Job], indices: Iterable[int]) -> Iterator[Job]:
        """Run jobs on the batches of these indices; yields each job when it is done on one batch.

        Raises:
            ValueError: labels or logits that cannot be read.
        """
        for index in indices:
            images, labels = self.batches[index]
            self._batch_digests[index] = _batch_digest(images, labels)
            images = images.to(self.device)
            labels = check_labels(labels, len(images), "labels").to(images.device)
            targets = None
            for job in jobs:
                pending_judges = []
                for judge in job.judges:
                    if self.key(job.condition, judge, index) not in self.records:
                        pending_judges.append(judge)
                if pending_judges:
                    if targets is None:
                        targets = self._targets(images, labels, index)
                    batches = self._scene_batches(images, labels, targets, index, job.condition)
                    goals = labels, targets
                    records = self._judge(batches, goals, job.condition, pending_judges, index)
                    self.records.append(records)
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
        if index not in self._batch_digests:  # a batch that another process has done
            self._batch_digests[index] = _batch_digest(*self.batches[index])
        batch = {"content": self._batch_digests[index], "index": index}
        return key_of(self._key_fields(condition) | {"judge": judge.identity, "batch": batch})

    def picture_name(self, condition: Condition) -> str:
        """Return the name of the picture of a condition."""
        return self.key(condition, UNDEFENDED, 0)

    def _key_fields(self, condition: Condition) -> dict[str, Any]:
        scene = self.scene if condition.scene is None else condition.scene
        fields = {
            "model": self.name,
            "scene": scene.to_dict(),
            "condition": condition.settings() | {"name": condition.name},
            "seed": self.seed,
        }
        if self._lpips_identity is not None and not condition.control:
            fields["lpips"] = self._lpips_identity
        return fields

    def _targets(self, images: Tensor, labels: Tensor, index: int) -> Tensor:
        """Draw one of the model's other classes for each image."""
        with evaluating(self.model, images), torch.no_grad():
            logits = self.model(images[:1].clone())
        check_classes(labels[:1], logits, 1)
        classes = logits.shape[1]
        generator = torch.Generator().manual_seed(mix_seeds(self.seed, index, 1))
        offset = torch.randint(1, classes, labels.shape, generator=generator, device="cpu")
        return (labels + offset.to(labels)) % classes

    def _scene_batches(
        self, images: Tensor, labels: Tensor, targets: Tensor, index: int, condition: Condition
    ) -> SceneBatches:
        """Draw a shot for each image; a mixture's images are a batch for each of its scenes."""
        scene = self.scene if condition.scene is None else condition.scene
        shot_generator = torch.Generator().manual_seed(mix_seeds(self.seed, index, 0))
        size = (images.shape[-2], images.shape[-1])
        shot = scene.sample(len(images), size, shot_generator).to(images.device)
        if isinstance(shot, MixedShot):
            shots = shot.by_scene()
        else:
            shots = [(torch.arange(len(images), device=images.device), shot)]
        seed = mix_seeds(self.seed, index, 2, _name_seed(condition.name))
        generator = torch.Generator().manual_seed(seed)
        batches = []
        for rows, scene_shot in shots:
            goals = labels[rows], targets[rows]
            batch = EvalBatch(self.model, images[rows], *goals, scene_shot, generator, self.lpips)
            batches.append(batch)
        return SceneBatches([rows for rows, _ in shots], batches)

    def _judge(
        self,
        batches: SceneBatches,
        goals: tuple[Tensor, Tensor],
        condition: Condition,
        judges: Sequence[Judge],
        index: int,
    ) -> list[Record]:
        labels, targets = goals
        # a randomised model or defence draws from the global generator: the same numbers
        # wherever this piece is computed
        devices = [labels.device] if labels.is_cuda else []
        with torch.random.fork_rng(devices), torch.no_grad():
            torch.manual_seed(mix_seeds(self.seed, index, 3, _name_seed(condition.name)))
            start = time.perf_counter()
            images = batches.show(condition)
            seconds_shown = _seconds_since(start, images.device)
            figures = batches.measure(condition, images)
            records = []
            for judge in judges:
                name_seeds = (_name_seed(condition.name), _name_seed(judge.name))
                torch.manual_seed(mix_seeds(self.seed, index, 4, *name_seeds))
                start = time.perf_counter()
                logits = batches.logits(judge, images)
                check_classes(labels, logits, 1)
                answers = predicted(logits).tolist()  # which waits for the device
                seconds = seconds_shown + time.perf_counter() - start
                record = self._record(condition, judge, index)
                record |= {"labels": labels.tolist(), "targets": targets.tolist()}
                record |= {"predicted": answers, "measured": figures, "seconds": seconds}
                records.append(record)
        if index == 0:
            self.records.keep_picture(self.picture_name(condition), images)
        return records

    def _record(self, condition: Condition, judge: Judge, index: int) -> Record:
        return {
            "key": self.key(condition, judge, index),
            "model": self.name,
            "condition": condition.name,
            "settings": condition.settings(),
            "judge": judge.name,
            "batch": index,
        }


def _batch_digest(images: Tensor, labels: Tensor) -> str:
    sha256 = hashlib.sha256(images.detach().cpu().contiguous().numpy().tobytes())
    sha256.update(str(labels.tolist()).encode())
    return sha256.hexdigest()[:16]


def _seconds_since(start: float, device: torch.device) -> float:
    if device.type == "cuda":
        torch.cuda.synchronize()
    return time.perf_counter() - start


def _name_seed(name: str) -> int:
    """Return a number for a name, the same on every machine."""
    return zlib.crc32(name.encode())
