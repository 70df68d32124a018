"""The state of a search: the images that still take steps, and the best point of each image."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from moireaug.attacks.checks import check_answers, check_classes
from moireaug.attacks.losses import attack_margin, is_same_answer, predicted
from moireaug.attacks.model import attacked_logits
from moireaug.attacks.problem import Point, Problem
from moireaug.common.networks import rejects_of
from moireaug.common.numeric import select_rows

# the points of a run, each with the logits (views * b, K) of the active images there; with the
# last, None, as no step needs them
Iterates = Iterator[tuple[Point, Tensor | None]]


@dataclass(eq=False)
class Search:
    """A search on a batch of n images, of which b still take steps.

    Args:
        model: attacked model.
        problem: problem of the n images.
        labels: (n,) true classes.
        targets: (n,) classes to reach; None where any wrong class is a success.
        generator: CPU generator of random starts; None is torch's global one.
        clean_correct: (n,) whether each image is right without noise; None until it is known.

    Attributes:
        loss_targets: (n,) classes that the loss steers toward, at first `targets`; None where it
            steers away from the label.
        rows: (b,) indices of the images that still take steps.
        active: problem of these b images.
        best: each image's point of the greatest margin, over steps and restarts.
        margins: (n,) greatest margins.
        rounding: (n,) margins that rounding, which differs between batches, may bring about.
        losses: mean cross-entropy before each step of the last run, see `follow`.
        drops_fooled: whether fooled images take no further steps.
        is_checked: whether logits have been checked, see `logits`.
        rejects: whether the model rejects images, see `networks.rejects_of`.
    """

    model: Callable[[Tensor], Tensor]
    problem: Problem
    labels: Tensor
    targets: Tensor | None
    generator: torch.Generator | None
    clean_correct: Tensor | None = None

    def __post_init__(self) -> None:
        self.loss_targets = self.targets
        self.rows = torch.arange(len(self.labels), device=self.labels.device)
        self.active, self.best = self.problem, Point()
        self.margins = torch.full_like(self.labels, -math.inf, dtype=torch.float32)
        self.rounding = torch.zeros_like(self.margins)
        self.losses: list[Tensor] = []
        self.drops_fooled = False
        self.is_checked = False
        self.rejects = rejects_of(self.model)

    @property
    def is_over(self) -> bool:
        """Whether no image takes a further step."""
        return self.drops_fooled and not len(self.rows)

    def active_rows(self, values: Tensor) -> Tensor:
        """Return the rows (b, ...) of values (n, ...) of the images that still take steps."""
        return values if len(self.rows) == len(values) else values[self.rows]

    def active_point(self, point: Point) -> Point:
        """Return the point of the images that still take steps, of a point of all."""
        return {name: self.active_rows(x) for name, x in point.items()}

    def scatter(self, values: Tensor) -> Tensor:
        """Put values (b, ...) into rows of a tensor (n, ...), with 0 for the other images."""
        n = len(self.labels)
        if len(self.rows) == n:
            return values
        return values.new_zeros(n, *values.shape[1:]).index_copy(0, self.rows, values)

    def active_goals(self, targets: Tensor | None) -> tuple[Tensor, Tensor | None]:
        """Return the active images' labels and those of their `targets` (n,), repeated for each
        view."""
        labels = self.active_rows(self.labels).repeat(self.active.views)
        if targets is None:
            return labels, None
        return labels, self.active_rows(targets).repeat(self.active.views)

    def logits(self, images: Tensor, labels: Tensor) -> Tensor:
        """Return the model's logits (N, K) of images (N, 3, H, W), see `attacked_logits`. The first
        are refused where they do not match the classes, or where neither they nor those of the
        clean images are finite."""
        logits = attacked_logits(self.model, images, labels, rejects=self.rejects)
        if not self.is_checked:
            check_classes(labels, logits)
            if self.targets is not None:
                check_classes(self.targets, logits[: len(self.targets)])
            check_answers(logits, self.model, self.problem.images)
            self.is_checked = True
        return logits

    @torch.no_grad()
    def active_logits(self, point: Point) -> Tensor:
        """Return the logits (views * b, K) of the active images at a point."""
        images = self.active.forward_views(self.active_point(point))
        return self.logits(images, self.active_goals(None)[0])

    @torch.no_grad()
    def images_and_logits(self, point: Point) -> tuple[Tensor, Tensor]:
        """Return the n images that are judged at a point, (n, 3, H, W), and their logits (n, K)."""
        images = self.problem.render(point)
        return images, self.logits(images, self.labels)

    @torch.no_grad()
    def is_right(self, images: Tensor, logits: Tensor) -> Tensor:
        """Return whether the model is right about each of the n images (n, 3, H, W), of which it
        has given these logits (n, K), (n,) bool. A rejected image is not: as the logits give the
        label its place, a model that rejects is asked again."""
        right = predicted(logits) == self.labels
        if self.rejects:
            right &= predicted(self.model(images.clone()), rejects=True) == self.labels
        return right

    def is_right_without_noise(self) -> Tensor:
        """Return whether each image is right without noise, (n,) bool; the model is asked if the
        search did not begin there."""
        if self.clean_correct is None:
            self.clean_correct = self.is_right(*self.images_and_logits(self.problem.clean_point()))
        return self.clean_correct

    def mean_loss(self, logits: Tensor) -> Tensor:
        """Return the mean cross-entropy of the logits (views * b, K) of the active images, which a
        Result reports."""
        labels, targets = self.active_goals(self.targets)
        return F.cross_entropy(logits.detach().float(), labels if targets is None else targets)

    def follow(self, iterates: Iterates, *, until_fooled: bool) -> None:
        """Keep the best points of a run, until no image takes a further step.

        until_fooled: whether fooled images take none, if the model, asked again at the first point,
            answers every active image the same; one that does is asked so no more.
        """
        self.losses = []
        for point, logits in iterates:
            if logits is None:
                self.keep(point, self.active_logits(point))
                break
            if until_fooled and not (self.losses or self.drops_fooled):
                self.drops_fooled = bool(is_same_answer(logits, self.active_logits(point)).all())
            self.losses.append(self.mean_loss(logits))
            self.keep(point, logits)
            if self.is_over:
                break

    def keep(self, point: Point, logits: Tensor) -> None:
        """Keep the point of each active image whose margin has grown, by the logits (views * b, K)
        of the active images; where `drops_fooled`, take no further steps for fooled ones."""
        self._note_clean_answer(point, logits)
        labels, targets = self.active_goals(self.targets)
        margins = attack_margin(logits, labels, targets).view(self.active.views, -1).mean(0)
        self._raise_rounding(logits, margins)
        better = self.scatter(margins > self.active_rows(self.margins))
        self.margins = torch.where(better, self.scatter(margins), self.margins)
        best = self.best or point
        self.best = {name: select_rows(better, x, best[name]) for name, x in point.items()}
        if self.drops_fooled:
            self.drop_fooled()

    def _note_clean_answer(self, point: Point, logits: Tensor) -> None:
        """Note which images are right without noise, if these logits are the first, and say so."""
        is_unknown = self.clean_correct is None and not self.rejects
        if is_unknown and self.active.views == 1 and not self.best and not point["noise"].any():
            self.clean_correct = predicted(logits) == self.labels

    def _raise_rounding(self, logits: Tensor, margins: Tensor) -> None:
        """Raise the rounding of active images to half of the digits of these logits and margins."""
        sizes = logits.amax(1).float().abs().view(self.active.views, -1).amax(0) + margins.abs()
        rounding = sizes.nan_to_num(0, 0, 0) * torch.finfo(logits.dtype).eps ** 0.5
        self.rounding = torch.maximum(self.rounding, self.scatter(rounding))

    def drop_fooled(self) -> None:
        """Take no further steps for images that are fooled by more than rounding."""
        self.drop(self.margins > self.rounding)

    def drop(self, is_done: Tensor) -> None:
        """Take no further steps for images of which `is_done` (n,) is true."""
        rows = self.rows[~is_done[self.rows]]
        if len(rows) < len(self.rows):
            self.rows, self.active = rows, self.problem.subset(rows)
