"""The loop of every gradient attack: each step gives logits, by which the search keeps each image's
best point, from which the result is made."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import torch
from torch import Tensor

from moireaug.attacks.base import ModelAttack
from moireaug.attacks.checks import check_eps
from moireaug.attacks.losses import LOSSES, is_success, loss_curve
from moireaug.attacks.model import check_differentiable, require_gradient
from moireaug.attacks.problem import Point, Problem
from moireaug.attacks.result import Result
from moireaug.attacks.rules import RULES, Rule
from moireaug.attacks.search import Iterates, Search
from moireaug.common.argument_checks import check_real, check_whole, one_of
from moireaug.common.numeric import widen_half
from moireaug.scene.mixed_shot import MixedShot
from moireaug.scenes import Shot


@dataclass(frozen=True, kw_only=True)
class Attack(ModelAttack):
    """Projected gradient ascent on noise inside an L-infinity ball; subclasses say how noise
    becomes an image.

    A gradient of NaN counts as zero; with the rule "sign", that element of the noise stays where it
    is. Logits that become NaN or infinite count as no answer, which is never right and never the
    target: in an untargeted attack, such an image counts as fooled.

    Args:
        model: (B, 3, H, W) images in [0, 1] to (B, K) logits. Its mode, buffers and gradients
            are the same after the attack as before, even if it raises.
        eps: L-infinity bound of the noise, in [0, 1] units; of sRGB values, unless
            `MoireAttack.bound` says otherwise.
        steps: gradient steps.
        step_size: in units of eps; None is min(1, 2.5 / steps), or 2 with the rule "apgd", and 1 /
            steps with "printed".
        rule: a key of `attacks.RULES`, the update of a step: "sign", "momentum", "apgd" or
            "printed".
        loss: a key of `attacks.LOSSES`: "ce", "margin" or "dlr"; each is targeted where there are
            targets. "ce" ascends the log-odds, whose gradient is the cross-entropy's over 1 - p_y,
            see `losses.log_odds`; `Result.loss` is the cross-entropy itself.
        random_start: radius of the uniform random start, in units of eps; 0 starts from no noise.
            Above 1, allowed only with a single step, the noise may end outside the ball: N-FGSM (de
            Jorge et al., 2022).
        restarts: number of runs, the later ones from a random start; the best per image is kept.
        until_fooled: whether the attack on an image stops once it is misclassified: as many are
            fooled, in less time, by noise that goes less far beyond the decision boundary. On a
            random model, whose answers to one input differ, every step is taken.

    A model that rejects images says so by an attribute `rejects = True`, see `defenses.Rejecting`:
    its last logit is then not that of a class, and a success is an image that is let through.
    """

    eps: float = 4 / 255
    steps: int = 20
    step_size: float | None = None
    rule: str = "sign"
    loss: str = "ce"
    random_start: float = 0.0
    restarts: int = 1
    until_fooled: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        check_eps(self.eps)
        object.__setattr__(self, "eps", float(self.eps))  # it may be NumPy's
        check_whole("steps", self.steps, 0)
        check_whole("restarts", self.restarts, 1)
        if self.step_size is not None:
            check_real("step_size", self.step_size, 0, unit="units of eps")
        check_real("random_start", self.random_start, 0, or_low=True, unit="units of eps")
        if self.random_start > 1 and self.steps != 1:
            raise ValueError(
                f"a random_start beyond the ball ({self.random_start!r} times eps) is for a single "
                f"step, which does not pull it back; got steps = {self.steps}. Use random_start <= "
                "1."
            )
        one_of("rule", self.rule, RULES)
        one_of("loss", self.loss, LOSSES)

    def attack(self, search: Search) -> Result:
        self.run_restarts(search)
        return self.result(search)

    def last(
        self,
        images: Tensor,
        labels: Tensor,
        *,
        shot: Shot | MixedShot | None = None,
        generator: torch.Generator | None = None,
    ) -> Tensor:
        """Return the images after the last step, (B, 3, H, W), even if an earlier one was better,
        for adversarial training: one forward and backward pass per step, and every step for every
        image. Arguments as in a call."""

        def render_last(search: Search) -> Tensor:
            point = self.last_point(search)
            with torch.no_grad():
                return search.problem.render(point)

        return self.in_scenes(render_last, images, labels, None, shot, generator)

    def run_restarts(self, search: Search) -> None:
        """Run every restart; the search keeps each image's point of the greatest margin."""
        for restart in range(self.restarts):
            if not search.is_over:
                search.follow(self.iterates(search, restart), until_fooled=self.until_fooled)

    def last_point(self, search: Search) -> Point:
        """Return the point after the last step of a run, which keeps none."""
        point, _ = deque(self.iterates(search), maxlen=1).pop()
        return point

    def iterates(self, search: Search, restart: int = 0) -> Iterates:
        """Yield the point before each step of a run, and the one after the last; a search that
        follows may take images out between two."""
        rules = self._rules(search.problem)
        point = self._start(search, restart)
        # where an image is black or white, a random start would have no gradient
        point = point | {name: rule.project(point[name]) for name, rule in rules.items()}
        for k in range(self.steps):
            logits, loss, gradients = self._ascent(search, point, checks=k == 0)
            yield point, logits
            for name, gradient in gradients.items():
                if name in rules:
                    point = point | {name: rules[name](point[name], gradient, loss)}
        yield point, None

    def _ascent(
        self, search: Search, point: Point, *, checks: bool
    ) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        """Return the logits (views * b, K) of the active images at a point; and, 0 for the others,
        the loss (n,), and its gradient in each variable of the point that it depends on."""
        active = search.active_point(point)
        variables = {name: x.detach().requires_grad_(True) for name, x in active.items()}
        images = search.active.forward_views(variables)
        labels, targets = search.active_goals(search.loss_targets)
        logits = search.logits(images, labels)
        if checks:
            check_differentiable(logits)
        loss = LOSSES[self.loss](widen_half(logits), labels, targets)
        # a scene may have ranges that no photo of it depends on
        slopes = torch.autograd.grad(loss.sum(), list(variables.values()), allow_unused=True)
        if checks:
            require_gradient(self.model, images, labels, slopes, rejects=search.rejects)
        gradients = {}
        for name, slope in zip(variables, slopes, strict=True):
            if slope is not None:
                # a NaN would stay in the point, and with it in every later image
                gradients[name] = search.scatter(slope.nan_to_num())
        image_loss = search.scatter(loss.detach().view(search.active.views, -1).mean(0))
        return logits.detach(), image_loss, gradients

    def _start(self, search: Search, restart: int) -> Point:
        """Return the starting point: no noise and the drawn pose, or random ones."""
        radius = self.eps * (self.random_start or (1.0 if restart else 0.0))
        return search.problem.start(radius, search.generator, random_pose=restart > 0)

    def _rules(self, problem: Problem) -> dict[str, Rule]:
        """Return a rule for each variable that moves."""
        rules, settings = {}, (self.steps, self.step_size)
        if not problem.noise_frozen:
            # noise that starts outside the ball (N-FGSM) takes its step without being pulled back
            bound = self.eps if self.random_start <= 1 else math.inf
            rules["noise"] = RULES[self.rule](self.eps, *settings, bound, problem)
        if problem.pose is not None:
            rules["pose"] = RULES[self.rule](1.0, *settings)
        return rules

    def result(self, search: Search) -> Result:
        """Return the Result at each image's best point."""
        problem, point = search.problem, search.best
        images, logits = search.images_and_logits(point)
        return Result(
            images=images,
            success=is_success(logits, search.labels, search.targets),
            noise=problem.noise_of(point),
            loss=loss_curve(search.losses),
            eps=self.eps,
            shot=problem.shot_of(point),
            clean_correct=search.is_right_without_noise(),
            correct=search.is_right(images, logits),
            bound=problem.unit,
        )
