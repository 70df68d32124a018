"""The one loop of every gradient attack here: projected steps along the sign of the gradient (Madry et al., 2018)."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from torch import Tensor, nn

from moireaug.attacks.losses import LOSSES, margin, reported
from moireaug.attacks.model import evaluating
from moireaug.capture import check_images
from moireaug.fields import one_of
from moireaug.shot import Shot


@dataclass(frozen=True, eq=False)
class Result:
    """What an attack found.

    Args:
        images: (B, 3, H, W) adversarial images in [0, 1], the best found per image.
        success: (B,) bool; the label is not predicted, or, targeted, the target is.
        noise: what was added: raw noise (B, 4, h, w) for MoireAttack, pixels (B, 3, H, W) for pixel attacks.
        loss: (steps,) mean cross-entropy to the label (targeted: to the target) before each step of the last restart.
        eps: its L-infinity bound.
        shot: the Shot of the photos, or None for pixel attacks.
    """

    images: Tensor
    success: Tensor
    noise: Tensor
    loss: Tensor
    eps: float
    shot: Shot | None = None


class Problem(NamedTuple):
    """How noise becomes images: `render` for the photo that counts, `rehearse` for the ones that a step is taken on."""

    render: Callable[[Tensor], Tensor]
    rehearse: Callable[[Tensor], Tensor]
    shape: tuple[int, ...]
    views: int = 1
    shot: Shot | None = None


@dataclass(frozen=True, kw_only=True)
class Attack(ABC):
    """Projected sign-gradient ascent on noise inside an L-infinity ball; subclasses say how noise becomes an image.

    Where a gradient is exactly zero its sign is zero, and that element of the noise stays where it is.

    Args:
        model: (B, 3, H, W) images in [0, 1] to (B, K) logits. Its mode, BatchNorm statistics and gradients are the same
            after the attack as before, also when it raises.
        eps: bound of the noise in [0, 1] units; a list gives one Result per value, in order.
        steps: gradient steps.
        step_size: in units of eps; None is min(1, 2.5 / steps).
        loss: a key of `attacks.LOSSES`: "ce" or "margin".
        random_start: radius of the uniform random start, in units of eps; 0 starts from no noise. Above 1, only with a
            single step, the noise may end outside the ball: N-FGSM (de Jorge et al., 2022).
        restarts: the attack is run so often, later runs from a random start, and the best per image is kept.
    """

    model: nn.Module | Callable[[Tensor], Tensor] = field(kw_only=False)
    eps: float | Sequence[float] = 4 / 255
    steps: int = 20
    step_size: float | None = None
    loss: str = "ce"
    random_start: float = 0.0
    restarts: int = 1

    def __post_init__(self) -> None:
        several = self.eps if isinstance(self.eps, (list, tuple)) else [self.eps]
        if not several or any(not (isinstance(e, (int, float)) and 0 <= e < math.inf) for e in several):
            raise ValueError(f"eps must be a number >= 0 in [0, 1] units, or a list of them; got {self.eps!r}.")
        if max(several) > 1:
            raise ValueError(f"eps is in [0, 1] units, where 1 is full scale; got {self.eps!r}. Divide by 255?")
        for name in ("steps", "restarts"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < (name == "restarts"):
                raise ValueError(f"{name} must be an integer >= {int(name == 'restarts')}; got {value!r}.")
        if self.step_size is not None and not self.step_size > 0:
            raise ValueError(f"step_size must be above 0, in units of eps; got {self.step_size!r}.")
        if not self.random_start >= 0:
            raise ValueError(f"random_start must be a radius >= 0, in units of eps; got {self.random_start!r}.")
        if self.random_start > 1 and self.steps > 1:
            raise ValueError(
                f"a random_start beyond the ball ({self.random_start!r} times eps) is for a single step, which "
                f"does not pull it back; got steps = {self.steps}. Use random_start <= 1."
            )
        one_of("loss", self.loss, LOSSES)

    @abstractmethod
    def problem(self, images: Tensor, shot: Shot | None, generator: torch.Generator | None) -> Problem:
        """How noise becomes images, for one batch."""

    def __call__(
        self,
        images: Tensor,
        labels: Tensor,
        targets: Tensor | None = None,
        *,
        shot: Shot | None = None,
        generator: torch.Generator | None = None,
    ) -> Result | list[Result]:
        """Attack a batch.

        Args:
            images: (B, 3, H, W) float in [0, 1].
            labels: (B,) int64 true classes.
            targets: (B,) int64 classes to reach; None is untargeted.
            shot: the pose that is attacked; None draws one.
            generator: CPU generator of the draw and of random starts; None is torch's global one.

        Returns:
            A Result, or a list of them where `eps` is a list.

        Raises:
            TypeError, ValueError: images or labels of the wrong type, shape or range.
        """
        check_images(images)
        with evaluating(self.model):
            images = images.detach().clone()
            labels = check_labels(labels, len(images), "labels").to(images.device).clone()
            if targets is not None:
                targets = check_labels(targets, len(images), "targets").to(images.device).clone()
            problem = self.problem(images, shot, generator)
            if isinstance(self.eps, (list, tuple)):
                return [self._best(problem, images, labels, targets, float(e), generator) for e in self.eps]
            return self._best(problem, images, labels, targets, float(self.eps), generator)

    def last(self, images: Tensor, labels: Tensor, *, shot: Shot | None = None,
             generator: torch.Generator | None = None) -> Tensor:  # fmt: skip
        """The images after the last step, (B, 3, H, W), whether or not an earlier step was better: what adversarial
        training uses, at one forward and backward pass a step and none beside. Arguments as in a call."""
        with evaluating(self.model):
            images = images.detach().clone()
            labels = check_labels(labels, len(images), "labels").to(images.device).clone()
            problem, eps = self.problem(images, shot, generator), float(self.eps)  # type: ignore[arg-type]
            noise = self._start(problem, eps, self.random_start, images, generator)
            noise = self._ascend(problem, noise, labels, None, eps, None)
            with torch.no_grad():
                return problem.render(noise).detach()

    def _start(
        self, problem: Problem, eps: float, radius: float, images: Tensor, generator: torch.Generator | None
    ) -> Tensor:
        noise = torch.zeros(problem.shape)
        if radius and eps:
            noise.uniform_(-radius * eps, radius * eps, generator=generator)
        return noise.to(images.device, images.dtype if images.dtype == torch.float64 else torch.float32)

    def _objective(self, logits: Tensor, labels: Tensor, targets: Tensor | None) -> Tensor:
        loss = LOSSES[self.loss]
        return loss(logits, labels) if targets is None else -loss(logits, targets)

    def _ascend(
        self,
        problem: Problem,
        noise: Tensor,
        labels: Tensor,
        targets: Tensor | None,
        eps: float,
        watch: Callable[[Tensor, Tensor], None] | None,
    ) -> Tensor:
        step = eps * (min(1.0, 2.5 / max(1, self.steps)) if self.step_size is None else self.step_size)
        # noise that starts outside the ball (N-FGSM) is stepped on, and not pulled back
        bound = eps if self.random_start <= 1 else math.inf
        many = labels.repeat(problem.views), None if targets is None else targets.repeat(problem.views)
        for k in range(self.steps):
            noise.requires_grad_(True)
            logits = self.model(problem.rehearse(noise))
            if k == 0:
                check_classes(labels if targets is None else torch.maximum(labels, targets), logits, problem.views)
            (gradient,) = torch.autograd.grad(self._objective(logits, *many).sum(), noise)
            if watch:
                watch(noise.detach(), logits.detach())
            noise = (noise.detach() + step * gradient.sign()).clamp(-bound, bound)
        return noise.detach()

    def _best(
        self,
        problem: Problem,
        images: Tensor,
        labels: Tensor,
        targets: Tensor | None,
        eps: float,
        generator: torch.Generator | None,
    ) -> Result:
        best = _Best(problem.shape, labels, targets, problem.views, images)
        for restart in range(self.restarts):
            radius = self.random_start or (1.0 if restart else 0.0)
            best.losses = []
            noise = self._ascend(
                problem, self._start(problem, eps, radius, images, generator), labels, targets, eps, best.watch
            )
            with torch.no_grad():
                best.watch(noise, self.model(problem.rehearse(noise)))
        with torch.no_grad():
            photo = problem.render(best.noise)
            hit = self.model(photo).argmax(1)
        success = hit != labels if targets is None else hit == targets
        losses = torch.stack(best.losses[: self.steps]) if self.steps else torch.zeros(0)
        return Result(photo.detach(), success, best.noise, losses.cpu(), eps, problem.shot)


class _Best:
    """Keeps each image's noise of the greatest margin, over steps and restarts, and the mean loss of each step."""

    def __init__(
        self, shape: tuple[int, ...], labels: Tensor, targets: Tensor | None, views: int, like: Tensor
    ) -> None:
        self.labels, self.targets, self.views = labels, targets, views
        self.noise = torch.zeros(shape, device=like.device)
        self.score = torch.full((shape[0],), -math.inf, device=like.device)
        self.losses: list[Tensor] = []

    def watch(self, noise: Tensor, logits: Tensor) -> None:
        goal = (self.labels if self.targets is None else self.targets).repeat(self.views)
        if not self.losses:
            check_classes(goal, logits, 1)
        score = margin(logits.float(), goal) * (1 if self.targets is None else -1)
        score = score.reshape(self.views, -1).mean(0)
        better = score > self.score
        self.score = torch.where(better, score, self.score)
        self.noise = torch.where(better[:, None, None, None], noise, self.noise.to(noise.dtype))
        self.losses.append(reported(logits, goal))


def check_labels(labels: Tensor, n: int, name: str) -> Tensor:
    """Refuse what is not (n,) integers >= 0.

    Raises:
        TypeError, ValueError: with what was got and what is allowed.
    """
    if not isinstance(labels, Tensor) or labels.is_floating_point() or labels.dtype == torch.bool:
        raise TypeError(
            f"{name} must be an integer tensor of class indices; got {getattr(labels, 'dtype', type(labels))}."
        )
    if labels.shape != (n,):
        raise ValueError(f"{name} must have the shape ({n},), one class an image; got {tuple(labels.shape)}.")
    if n and labels.min() < 0:
        raise ValueError(f"{name} must be class indices >= 0; got {int(labels.min())}.")
    return labels.long()


def check_classes(labels: Tensor, logits: Tensor, views: int) -> None:
    """Refuse logits that are not (views * n, K), and labels that are not below K."""
    if logits.ndim != 2 or len(logits) != len(labels) * views:
        raise ValueError(f"the model must return logits (B, K); got {tuple(logits.shape)} for {len(labels)} images.")
    if len(labels) and labels.max() >= logits.shape[1]:
        raise ValueError(
            f"labels and targets must lie in [0, {logits.shape[1] - 1}], the model's classes; got {int(labels.max())}. "
            "A class_index file maps a folder's classes to a pretrained model's."
        )
