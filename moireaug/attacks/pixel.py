"""Attacks on the pixels of an image, without a camera, for comparison."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from torch import Tensor, nn

from moireaug.attacks.answers import has_prediction, reaches
from moireaug.attacks.checks import (
    check_answers,
    check_classes,
    check_count,
    check_goals,
    check_gradient,
    check_model,
    is_finite,
)
from moireaug.attacks.loop import Attack
from moireaug.attacks.losses import loss_curve, margin, mean_cross_entropy
from moireaug.attacks.model import evaluating
from moireaug.attacks.problem import Point, Problem
from moireaug.attacks.result import Result
from moireaug.attacks.rules import choose
from moireaug.image_checks import check_images
from moireaug.mixed_shot import MixedShot
from moireaug.numeric import clip
from moireaug.scenes import Shot

TANH_LIMIT = 1 - 1e-6  # a pixel's largest |tanh(w)|: black and white would lie at infinity


@dataclass(eq=False)
class PixelProblem(Problem):
    """Noise on the pixels of images."""

    images: Tensor

    def __post_init__(self) -> None:
        self.shape = tuple(self.images.shape)
        self.base = self.images if self.images.dtype == torch.float64 else self.images.float()
        self.effective_range = 0.0, 1.0

    def render(self, point: Point) -> Tensor:
        return clip(self.images + point["noise"]).to(self.images.dtype)

    def subset(self, rows: Tensor) -> PixelProblem:
        return PixelProblem(self.images[rows])


@dataclass(frozen=True, kw_only=True)
class PGD(Attack):
    """Projected gradient descent on pixels (Madry et al., 2018), from a uniform random start; see
    `Attack`.

    Raises:
        ValueError: a shot, which has no meaning here, or the rule "printed", which adds to a
            camera's reading.
    """

    random_start: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.rule == "printed":
            raise ValueError(
                "the rule 'printed' adds to a camera's reading; a pixel attack has none. Use "
                "'sign'."
            )

    def problem(
        self, images: Tensor, shot: Shot | MixedShot | None, generator: torch.Generator | None
    ) -> Problem:
        refuse_shot(shot)

        return PixelProblem(images)


@dataclass(frozen=True, kw_only=True)
class BIM(PGD):
    """The basic iterative method (Kurakin et al., 2017): PGD that starts from no noise."""

    random_start: float = 0.0


@dataclass(frozen=True, kw_only=True)
class MIFGSM(PGD):
    """The momentum iterative method (Dong et al., 2018, Algorithm 1; there with
    `step_size = 1 / steps`)."""

    rule: str = "momentum"
    random_start: float = 0.0


@dataclass(frozen=True, kw_only=True)
class CW:
    """The attack of Carlini & Wagner (2017, section VI.A) with an L2 distance: Adam on w, where the
    image is (tanh(w) + 1) / 2, descends |image - x|^2 + c max(-margin, -confidence). No bound, and
    no search for c.

    The nearest image that reaches the goal by a margin of `confidence` is kept, or the image itself
    where none does. In the Result, `noise` is the difference to the image, and `eps` its largest
    absolute value in the batch.

    Args:
        model: as in `Attack`.
        c: weight of the goal against the distance, above 0.
        confidence: kappa of the paper, >= 0: margin by which the goal is exceeded, in logits.
        steps: Adam steps; the start and every step's image but the last are judged.
        lr: Adam's learning rate, in tanh space.

    Raises:
        ValueError: settings out of range.
    """

    model: nn.Module | Callable[[Tensor], Tensor] = field(kw_only=False)
    c: float = 1.0
    confidence: float = 0.0
    steps: int = 50
    lr: float = 0.01

    def __post_init__(self) -> None:
        check_model(self.model)
        check_count("steps", self.steps, 0)
        for name in ("c", "lr"):
            if not (is_finite(getattr(self, name)) and getattr(self, name) > 0):
                raise ValueError(
                    f"{name} must be a finite number above 0; got {getattr(self, name)!r}."
                )
        if not (is_finite(self.confidence) and self.confidence >= 0):
            raise ValueError(
                f"confidence must be a finite number >= 0, in logits; got {self.confidence!r}."
            )

    def __call__(
        self,
        images: Tensor,
        labels: Tensor,
        targets: Tensor | None = None,
        *,
        shot: Shot | MixedShot | None = None,
        generator: torch.Generator | None = None,
    ) -> Result:
        """Attack a batch; arguments, Result and errors as of `Attack`. Nothing is drawn from the
        generator."""
        images = check_images(images)
        refuse_shot(shot)
        with evaluating(self.model, images):
            images = images.detach().clone()
            labels, targets = check_goals(images, labels, targets)
            classes = labels if targets is None else torch.maximum(labels, targets)
            goal, sign = (labels, 1.0) if targets is None else (targets, -1.0)
            x = images if images.dtype == torch.float64 else images.float()
            w = torch.atanh((x * 2 - 1).clamp(-TANH_LIMIT, TANH_LIMIT)).requires_grad_(True)
            adam = torch.optim.Adam([w], lr=self.lr)
            nearest, losses = x, []
            nearest_distance = torch.full_like(x[:, 0, 0, 0], float("inf"))
            for k in range(self.steps):
                candidate = (torch.tanh(w) + 1) / 2
                # a model may work in place
                logits = self.model(candidate.to(images.dtype, copy=True))
                if k == 0:
                    check_classes(classes, logits, 1)
                    check_answers(logits, self.model, images)
                    check_gradient(logits)
                    check_gradient(logits, _logits_gradient(logits, w))
                distance = (candidate - x).square().sum((1, 2, 3))
                lead = sign * margin(logits, goal)
                # torch.clamp would pass no gradient where both classes tie
                shortfall = torch.where(lead > self.confidence, -self.confidence, -lead)
                cost = distance.sum() + self.c * shortfall.sum()
                (gradient,) = torch.autograd.grad(cost, w)
                w.grad = gradient.nan_to_num()
                adam.step()
                losses.append(mean_cross_entropy(logits, goal))
                fooled = reaches(logits, labels, targets)
                fooled &= (lead >= self.confidence) | ~has_prediction(logits)
                is_nearer = fooled & (distance < nearest_distance)
                nearest_distance = torch.where(is_nearer, distance, nearest_distance).detach()
                nearest = choose(is_nearer, candidate.detach(), nearest)
            photo = nearest.to(images.dtype)
            with torch.no_grad():
                logits = self.model(photo.clone())
            check_classes(classes, logits, 1)
            check_answers(logits, self.model, images)  # without steps, nothing was checked yet
        success = reaches(logits, labels, targets)
        noise = nearest - x
        eps = noise.abs().max().item() if noise.numel() else 0.0
        return Result(photo, success, noise, loss_curve(losses), eps)


def _logits_gradient(logits: Tensor, w: Tensor) -> tuple[Tensor | None, ...]:
    """Return the gradient of all logits in w; None where they do not depend on it."""
    return torch.autograd.grad(logits.sum(), w, allow_unused=True, retain_graph=True)


def refuse_shot(shot: Shot | MixedShot | None) -> None:
    """Refuse a shot, which a pixel attack has no use for."""
    if shot is not None:
        raise ValueError(
            "a pixel attack has no camera: leave shot out, or use attacks.MoireAttack."
        )
