"""The attack of Carlini & Wagner: the nearest image that fools a model."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar, cast

import torch
from torch import Tensor

from moireaug.attacks.base import ModelAttack
from moireaug.attacks.losses import has_prediction, is_success, loss_curve, margin
from moireaug.attacks.model import check_differentiable, require_gradient
from moireaug.attacks.pixel import PixelProblem
from moireaug.attacks.result import Result
from moireaug.attacks.search import Search
from moireaug.common.argument_checks import check_real, check_whole
from moireaug.common.numeric import select_rows

TANH_LIMIT = 1 - 1e-6  # a pixel's largest |tanh(w)|: black and white would lie at infinity


@dataclass(frozen=True, kw_only=True)
class CW(ModelAttack):
    """The attack of Carlini & Wagner (2017, section VI.A) with an L2 distance: Adam on w, where the
    image is (tanh(w) + 1) / 2, descends |image - x|^2 + c max(-margin, -confidence). No bound.

    The nearest image that reaches the goal by a margin of `confidence` is kept, or the image itself
    where none does. In the Result, `noise` is the difference to the image, and `eps` its largest
    absolute value in the batch. Nothing is drawn from a call's generator.

    Args:
        model: as in `Attack`.
        c: weight of the goal against the distance, above 0.
        confidence: kappa of the paper, >= 0: margin by which the goal is exceeded, in logits.
        binary_search_steps: runs, each from the image itself, between which each image's c goes to
            the middle between the greatest that failed and the least that succeeded, or, until one
            has, to ten times as much. The paper's are 9, from c = 1e-3. The default, 1, keeps c, as
            torchattacks does: fewer images are fooled, by more noise.
        steps: Adam steps of a run; its image after the last step is not classified.
        lr: Adam's learning rate, in tanh space.

    Raises:
        TypeError, ValueError: settings of the wrong type or out of range.
    """

    has_bound: ClassVar[bool] = False
    _example: ClassVar[str] = "c=1"

    c: float = 1.0
    binary_search_steps: int = 1
    confidence: float = 0.0
    steps: int = 50
    lr: float = 0.01

    def __post_init__(self) -> None:
        super().__post_init__()
        check_whole("steps", self.steps, 0)
        check_whole("binary_search_steps", self.binary_search_steps, 1)
        check_real("c", self.c, 0)
        check_real("lr", self.lr, 0)
        check_real("confidence", self.confidence, 0, or_low=True, unit="logits")

    def problem(self, images: Tensor, shot: Any, generator: torch.Generator | None) -> PixelProblem:
        return PixelProblem(images)

    def attack(self, search: Search) -> Result:
        images, base = search.problem.images, cast(PixelProblem, search.problem).base
        labels, targets = search.labels, search.targets
        pixels = self._nearest(search, base)
        photo = pixels.to(images.dtype)
        with torch.no_grad():
            logits = search.logits(photo, labels)
        clean_correct = search.is_right_without_noise()
        correct = search.is_right(photo, logits)
        noise = pixels - base
        eps = noise.abs().max().item() if noise.numel() else 0.0
        success, losses = is_success(logits, labels, targets), loss_curve(search.losses)
        return Result(photo, success, noise, losses, eps, None, clean_correct, correct)

    def _nearest(self, search: Search, x: Tensor) -> Tensor:
        """Return the nearest image to x (B, 3, H, W) that reaches each goal, or x itself."""
        c = torch.full_like(x[:, 0, 0, 0], self.c)
        failed, reached = torch.zeros_like(c), torch.full_like(c, math.inf)
        nearest, nearest_distance = x, torch.full_like(c, math.inf)
        for _ in range(self.binary_search_steps):
            image, distance = self._descend(search, x, c)
            is_nearer = distance < nearest_distance
            nearest = select_rows(is_nearer, image, nearest)
            nearest_distance = torch.minimum(distance, nearest_distance)
            success = distance.isfinite()
            reached = torch.where(success, torch.minimum(reached, c), reached)
            failed = torch.where(success, failed, torch.maximum(failed, c))
            c = torch.where(reached.isfinite(), (failed + reached) / 2, 10 * c)
        return nearest

    def _descend(self, search: Search, x: Tensor, c: Tensor) -> tuple[Tensor, Tensor]:
        """Run Adam from x with the weights c (B,); return the nearest image that reaches each goal,
        and its squared distance (B,), infinity where none does."""
        labels, targets = search.labels, search.targets
        search.losses = []
        w = torch.atanh((x * 2 - 1).clamp(-TANH_LIMIT, TANH_LIMIT)).requires_grad_(True)
        adam = torch.optim.Adam([w], lr=self.lr)
        nearest, nearest_distance = x, torch.full_like(c, math.inf)
        for k in range(self.steps):
            candidate = (torch.tanh(w) + 1) / 2
            photo = candidate.to(search.problem.images.dtype)
            logits = search.logits(photo, labels)
            if k == 0:
                check_differentiable(logits)
                slopes = torch.autograd.grad(logits.sum(), w, allow_unused=True, retain_graph=True)
                require_gradient(self.model, photo, labels, slopes, rejects=search.rejects)
            distance = (candidate - x).square().sum((1, 2, 3))
            lead = margin(logits, labels, targets)
            # torch.clamp would pass no gradient where both classes tie
            shortfall = torch.where(lead > self.confidence, -self.confidence, -lead)
            (gradient,) = torch.autograd.grad((distance + c * shortfall).sum(), w)
            w.grad = gradient.nan_to_num()
            adam.step()
            search.losses.append(search.mean_loss(logits))
            is_enough = (lead >= self.confidence) | ~has_prediction(logits)
            success = is_success(logits, labels, targets) & is_enough
            is_nearer = success & (distance < nearest_distance)
            nearest_distance = torch.where(is_nearer, distance, nearest_distance).detach()
            nearest = select_rows(is_nearer, candidate.detach(), nearest)
        return nearest, nearest_distance
