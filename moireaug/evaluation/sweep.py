"""The sweep: every rung shown to every judge, batch by batch; each finished piece is a record that can be kept."""

from __future__ import annotations

import hashlib
import time
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from moireaug.attacks import UNDECIDED, evaluating, predicted
from moireaug.attacks.checks import check_classes, check_labels
from moireaug.evaluation.rungs import CLEAN, Bout, Model, Rung
from moireaug.evaluation.statistics import mix, wilson
from moireaug.scene.scene import Scene

Record = dict[str, Any]
Batch = tuple[Tensor, Tensor]


@dataclass(frozen=True)
class Judge:
    """Who is shown a rung's pictures: the attacked model, the model behind a defence, or another model.

    Args:
        name: stands for the judge in files. title: for people.
        see: (Bout, images) to logits.
        base: name of the judge without a defence; success counts the images that it has right when clean.
    """

    name: str
    title: str
    see: Callable[[Bout, Tensor], Tensor]
    base: str = "model"


MODEL = Judge("model", "no defence", lambda b, shown: b.model(shown))  # type: ignore[operator]


def behind(name: str, title: str, defence: Callable[[Tensor], Tensor]) -> Judge:
    """The attacked model behind a defence."""
    return Judge(name, title, lambda b, shown: b.model(defence(shown)))  # type: ignore[operator]


def other(title: str, model: Model) -> Judge:
    """Another model, to which the attacked one's pictures are shown: transfer. Its name changes with its weights."""
    name = f"{title}#{digest(model) if isinstance(model, nn.Module) else ''}"

    def see(b: Bout, shown: Tensor) -> Tensor:
        with evaluating(model), torch.no_grad():
            return model(shown)

    return Judge(name, title, see, base=name)


def digest(model: nn.Module) -> str:
    """Sixteen hex digits that change with any weight."""
    sums = hashlib.sha256()
    for name, value in model.state_dict().items():
        sums.update(name.encode())
        sums.update(value.detach().cpu().contiguous().view(-1).view(torch.uint8).numpy())
    return sums.hexdigest()[:16]


class Job(NamedTuple):
    """One rung and all who are to see it."""

    rung: Rung
    judges: tuple[Judge, ...]


@dataclass
class Row:
    """What one rung did to one judge.

    Args:
        correct: (n,) bool, the label is predicted. fooled: (n,) bool, the attack's goal is reached.
        counted: (n,) bool, the images that the judge, without its defence, has right when clean: success is counted on
            these.
        undecided: (n,) bool, the logits were not finite: correct for no label, and never the target.
        seconds: wall time of showing and judging. measured: means over the images of what the rung measures beside.
    """

    name: str
    title: str
    eps: float
    targeted: bool
    seconds: float = 0.0
    correct: list[bool] = field(default_factory=list)
    fooled: list[bool] = field(default_factory=list)
    counted: list[bool] = field(default_factory=list)
    measured: dict[str, float] = field(default_factory=dict)
    undecided: list[bool] = field(default_factory=list)

    @property
    def accuracy(self) -> float:
        return sum(self.correct) / max(1, len(self.correct))

    @property
    def hits(self) -> int:
        return sum(f and c for f, c in zip(self.fooled, self.counted, strict=True))

    def to_dict(self) -> dict[str, Any]:
        """The row for `metrics.json`: rates with their 95 % intervals and denominators."""
        n, m, hits = len(self.correct), sum(self.counted), self.hits
        out = {
            "name": self.name,
            "title": self.title,
            "eps": self.eps,
            "targeted": self.targeted,
            "accuracy": self.accuracy,
            "accuracy_interval": list(wilson(sum(self.correct), n)),
            "success": hits / m if m else None,
            "success_interval": list(wilson(hits, m)),
            "n": n,
            "counted": m,
            "undecided": sum(self.undecided),
            "seconds": self.seconds,
        }
        return out | ({"measured": self.measured} if self.measured else {})


class Index(dict[tuple[str, str], dict[int, Record]]):
    """Records by rung and judge, then by place."""

    def __init__(self, records: Iterable[Record] = ()) -> None:
        super().__init__()
        self.add(records)

    def add(self, records: Iterable[Record]) -> None:
        for r in records:
            self.setdefault((r["rung"], r["judge"]), {})[r["place"]] = r


def gather(index: Index, rung: Rung, judge: Judge) -> Row:
    """All batches of one rung before one judge, as one row, in the order of the images."""
    row, shown = Row(rung.name, rung.title, rung.eps, rung.targeted), []
    for place, r in sorted(index.get((rung.name, judge.name), {}).items()):
        clean = index[CLEAN.name, judge.base][place]
        row.correct += [p == y for p, y in zip(r["predicted"], r["labels"], strict=True)]
        goal = r["targets"] if rung.targeted else r["labels"]
        row.fooled += [(p == g) == rung.targeted for p, g in zip(r["predicted"], goal, strict=True)]
        row.counted += [p == y for p, y in zip(clean["predicted"], clean["labels"], strict=True)]
        row.undecided += [p == UNDECIDED for p in r["predicted"]]
        row.seconds += r["seconds"]
        shown.append((len(r["labels"]), r.get("measured") or {}))
    total = sum(n for n, _ in shown)
    for key in shown[0][1] if shown else ():
        row.measured[key] = sum(n * v[key] for n, v in shown) / total
    return row


def complete(jobs: Sequence[Job]) -> list[Job]:
    """The jobs, each rung once, led by the clean images before every judge without a defence: these say which images
    count. One rung's judges come from all jobs of its name."""
    rungs: dict[str, Rung] = {CLEAN.name: CLEAN}
    judges: dict[str, dict[str, Judge]] = {CLEAN.name: {MODEL.name: MODEL}}
    for rung, seers in jobs:
        rungs.setdefault(rung.name, rung)
        for judge in seers:
            judges.setdefault(rung.name, {})[judge.name] = judge
            if judge.base == judge.name:
                judges[CLEAN.name][judge.name] = judge
    return [Job(rungs[name], tuple(judges[name].values())) for name in rungs]


def sweep(
    model: Model,
    batch: Callable[[int], Batch],
    places: Sequence[int],
    scene: Scene,
    jobs: Sequence[Job],
    *,
    seed: int = 0,
    done: set[tuple[int, str, str]] = frozenset(),  # type: ignore[assignment]
    watch: Callable[[int, Rung, Tensor], None] | None = None,
) -> Iterator[list[Record]]:
    """Show every rung to its judges; yields the new records of one place and one rung at a time, which may be none.

    Args:
        model: [0, 1] images to logits; left as it was found.
        batch: a place to its (images (B, 3, H, W) in [0, 1], labels (B,)); called only for places with work left.
        places: which batches are this process's. What is drawn depends on the seed, the place and the names of rung
            and judge alone, so that any process, or a later one, gets the same.
        scene: whose shots are drawn, one per image.
        jobs: what to show to whom; `complete` them first.
        seed: of shots, targets, random starts and randomised judges.
        done: (place, rung, judge) that need not be done again.
        watch: called with the place, the rung and what it showed.
    """
    for place in places:
        open_jobs = [Job(r, tuple(j for j in js if (place, r.name, j.name) not in done)) for r, js in jobs]
        if not any(judges for _, judges in open_jobs):
            yield from ([] for _ in jobs)
            continue
        images, labels = batch(place)
        labels = check_labels(labels, len(images), "labels").to(images.device)
        targets = _targets(model, images, labels, mix(seed, place, 1))
        for rung, judges in open_jobs:
            found: list[Record] = []
            if judges:
                own = scene if rung.scene is None else rung.scene(scene)
                draws = torch.Generator().manual_seed(mix(seed, place, 0))
                shot = own.sample(len(images), tuple(images.shape[-2:]), draws).to(images.device)
                generator = torch.Generator().manual_seed(mix(seed, place, 2, _digits(rung.name)))
                bout = Bout(model, images, labels, targets, shot, generator)
                found = _judge(bout, rung, judges, place, seed, watch)
            yield found


def _targets(model: Model, images: Tensor, labels: Tensor, seed: int) -> Tensor:
    """A random other class of the model's an image."""
    with evaluating(model), torch.no_grad():
        logits = model(images[:1])
    check_classes(labels[:1], logits, 1)
    classes = logits.shape[1]
    if classes < 2:
        raise ValueError(f"the model must tell at least two classes apart; it returns {classes} logit.")
    offset = torch.randint(1, classes, labels.shape, generator=torch.Generator().manual_seed(seed))
    return (labels + offset.to(labels)) % classes


def _judge(
    b: Bout, rung: Rung, judges: Sequence[Judge], place: int, seed: int, watch: Callable[..., None] | None
) -> list[Record]:
    # a randomised model or defence draws from the global generator: the same numbers wherever this piece is computed
    with torch.random.fork_rng():
        torch.manual_seed(mix(seed, place, 3, _digits(rung.name)))
        start = time.perf_counter()
        with torch.no_grad():
            shown = _in_parts(rung.show, b)
        shown_in = _wait(shown, start)
        measured = {}
        if rung.measure:
            with torch.no_grad():
                measured = rung.measure(b, shown)
        found = []
        for judge in judges:
            torch.manual_seed(mix(seed, place, 4, _digits(rung.name), _digits(judge.name)))
            start = time.perf_counter()
            with evaluating(b.model), torch.no_grad():
                logits = judge.see(b, shown)
            check_classes(b.labels, logits, 1)
            answers = predicted(logits).tolist()
            seconds = shown_in + time.perf_counter() - start  # the list has waited for the device
            record = {"place": place, "rung": rung.name, "judge": judge.name, "predicted": answers}
            record |= {"labels": b.labels.tolist(), "targets": b.targets.tolist(), "seconds": seconds}
            found.append(record | ({"measured": measured} if measured else {}))
    if watch:
        watch(place, rung, shown)
    return found


def _in_parts(show: Callable[[Bout], Tensor], b: Bout) -> Tensor:
    """The whole batch at once, or, where the device's memory does not hold it, half and half. The halves then draw
    their random numbers one after the other: other ones than the whole would, but the same each time."""
    states = b.generator.get_state(), torch.get_rng_state()
    try:
        return show(b)
    except torch.OutOfMemoryError:
        if len(b.images) == 1:
            raise
    b.generator.set_state(states[0])
    torch.set_rng_state(states[1])
    torch.cuda.empty_cache()  # outside of the handler, whose traceback keeps the tensors alive
    middle = len(b.images) // 2
    return torch.cat([_in_parts(show, b[:middle]), _in_parts(show, b[middle:])])


def _wait(shown: Tensor, start: float) -> float:
    if shown.is_cuda:
        torch.cuda.synchronize()
    return time.perf_counter() - start


def _digits(name: str) -> int:
    """A number that stands for a name on every machine."""
    return zlib.crc32(name.encode())
