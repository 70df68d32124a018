"""The ladder: how much of an attack's success is the camera, how much the moiré, how much the noise.

Every rung shows a model the same images through the same shots; each adds one thing to the rung before. The paper's
tables lack the rungs between clean and attacked: on ImageNet the moiré alone often fools as many images as the attack.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor, nn

from moireaug.attacks import PGD, MoireAttack, evaluating
from moireaug.attacks.loop import check_classes, check_labels
from moireaug.capture import capture, develop, expose
from moireaug.effects.tone import clip
from moireaug.evaluation.statistics import mix, ratio_of_means, wilson
from moireaug.scene import Scene, as_scene
from moireaug.shot import Shot

Model = nn.Module | Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class Bout:
    """What a rung is given: one batch, its shot, its targets, and a generator of its own."""

    model: Model
    images: Tensor
    labels: Tensor
    targets: Tensor
    shot: Shot
    generator: torch.Generator


@dataclass(frozen=True)
class Rung:
    """One row of the ladder: a name, and how it turns a batch into the images that the model is shown."""

    name: str
    title: str
    show: Callable[[Bout], Tensor]
    eps: float = 0.0
    targeted: bool = False


def no_moire(shot: Shot) -> Shot:
    """The same shot of a panel without subpixels: camera, light and noise stay, the stripes leave their mean light."""
    even = dataclasses.replace(shot.scene.sensor, exposure="mean")
    return dataclasses.replace(shot, scene=dataclasses.replace(shot.scene, sensor=even))


def _dimmed(b: Bout) -> Tensor:
    return clip(b.images * ratio_of_means(capture(b.images, b.shot), b.images))


def _random_noise(eps: float) -> Callable[[Bout], Tensor]:
    def show(b: Bout) -> Tensor:
        signs = torch.randint(0, 2, b.shot.raw_shape(), generator=b.generator).to(b.images) * 2 - 1
        return develop(expose(b.images, b.shot) + eps * signs, b.shot)

    return show


def _moire_attack(eps: float, steps: int, targeted: bool = False, **settings: Any) -> Callable[[Bout], Tensor]:
    def show(b: Bout) -> Tensor:
        attack = MoireAttack(model=b.model, scene=b.shot.scene, eps=eps, steps=steps, **settings)
        return attack(b.images, b.labels, b.targets if targeted else None, shot=b.shot, generator=b.generator).images

    return show


def _pgd(eps: float, steps: int) -> Callable[[Bout], Tensor]:
    def show(b: Bout) -> Tensor:
        return PGD(model=b.model, eps=eps, steps=steps)(b.images, b.labels, generator=b.generator).images

    return show


def middle(eps: Sequence[float]) -> float:
    """The bound that stands for the others: of the targeted attack, the rival's and the pictures."""
    return sorted(eps)[len(eps) // 2]


def ladder(eps: Sequence[float] = (2 / 255, 4 / 255, 8 / 255), steps: int = 20) -> list[Rung]:
    """The rungs, in order: controls first, then the Moiré Attack at each eps, targeted at the middle one, then PGD.

    Args:
        eps: bounds of the Moiré Attack, in [0, 1] units.
        steps: gradient steps of every attack.
    """
    eps = sorted(eps)
    half, top = middle(eps), eps[-1]

    def label(e: float) -> str:
        return f"{e * 255:g}"

    return [
        Rung("clean", "clean image", lambda b: b.images),
        Rung("dimmed", "dimmed to the photo's mean", _dimmed),
        Rung("no_moire", "photo, no moiré", lambda b: capture(b.images, no_moire(b.shot))),
        Rung("moire", "photo with moiré, no noise", lambda b: capture(b.images, b.shot)),
        Rung(f"random_{label(top)}", f"moiré, random noise {label(top)}/255", _random_noise(top), top),
        *[Rung(f"ma_{label(e)}", f"Moiré Attack {label(e)}/255", _moire_attack(e, steps), e) for e in eps],
        Rung(
            f"ma_{label(half)}_targeted", f"targeted Moiré Attack {label(half)}/255",
            _moire_attack(half, steps, targeted=True), half, targeted=True,
        ),
        Rung(f"pgd_{label(half)}", f"PGD on pixels {label(half)}/255", _pgd(half, steps), half),
    ]  # fmt: skip


@dataclass
class Row:
    """What one rung did to one model.

    Args:
        correct: (n,) bool, the label is predicted. fooled: (n,) bool, the attack's goal is reached.
        counted: (n,) bool, the images that the model classifies correctly when clean: success is counted on these.
        seconds: wall time of the rung.
    """

    name: str
    title: str
    eps: float
    targeted: bool
    seconds: float = 0.0
    correct: list[bool] = field(default_factory=list)
    fooled: list[bool] = field(default_factory=list)
    counted: list[bool] = field(default_factory=list)

    @property
    def accuracy(self) -> float:
        return sum(self.correct) / max(1, len(self.correct))

    def to_dict(self) -> dict[str, Any]:
        """The row for `metrics.json`: rates with their 95 % intervals and denominators."""
        n, m = len(self.correct), sum(self.counted)
        hits = sum(f and c for f, c in zip(self.fooled, self.counted, strict=True))
        return {
            "name": self.name,
            "title": self.title,
            "eps": self.eps,
            "targeted": self.targeted,
            "accuracy": self.accuracy,
            "accuracy_interval": list(wilson(sum(self.correct), n)),
            "success": hits / m if m else 0.0,
            "success_interval": list(wilson(hits, m)),
            "n": n,
            "counted": m,
            "seconds": self.seconds,
        }


def climb(
    model: Model,
    batches: Iterable[tuple[Tensor, Tensor]],
    scene: Scene | str | dict,
    rungs: Sequence[Rung] | None = None,
    *,
    seed: int = 0,
    classes: int | None = None,
) -> Iterator[list[Row]]:
    """Climb the ladder batch by batch; yields the rows so far after each batch, the same list every time.

    Args:
        model: [0, 1] images to logits; left as it was found.
        batches: (images (B, 3, H, W) in [0, 1], labels (B,)).
        scene: whose shots are drawn, one per image; the draws depend on the seed and the batch's place alone, so that
            two models meet the same photos.
        rungs: `ladder()` by default.
        seed: of shots, targets and random starts.
        classes: number of classes to choose targets from; by default as many as the model has logits.
    """
    scene, rungs = as_scene(scene), list(ladder() if rungs is None else rungs)
    rows = [Row(r.name, r.title, r.eps, r.targeted) for r in rungs]
    for place, (images, labels) in enumerate(batches):
        labels = check_labels(labels, len(images), "labels").to(images.device)
        draws = torch.Generator().manual_seed(mix(seed, place, 0))
        shot = scene.sample(len(images), tuple(images.shape[-2:]), draws).to(images.device)
        with evaluating(model), torch.no_grad():
            logits = model(images)
        check_classes(labels, logits, 1)
        clean = (logits.argmax(1) == labels).tolist()
        k = classes or logits.shape[1]
        offset = torch.randint(1, max(2, k), labels.shape, generator=draws).to(labels)
        targets = (labels + offset) % k
        for i, (rung, row) in enumerate(zip(rungs, rows, strict=True)):
            generator = torch.Generator().manual_seed(mix(seed, place, i + 1))
            start = time.perf_counter()
            with torch.no_grad():
                shown = rung.show(Bout(model, images, labels, targets, shot, generator))
            with evaluating(model), torch.no_grad():
                predicted = model(shown).argmax(1)
            row.correct += (predicted == labels).tolist()
            row.fooled += (predicted == targets if rung.targeted else predicted != labels).tolist()
            row.seconds += time.perf_counter() - start  # the lists have waited for the device
            row.counted += clean
        yield rows
