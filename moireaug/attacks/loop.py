"""The loop of every gradient attack: projected steps of an update rule, and the best point of each
image."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from numbers import Real

import torch
from torch import Tensor, nn

from moireaug.attacks.answers import predicted
from moireaug.attacks.best import BestPoints
from moireaug.attacks.checks import (
    check_answers,
    check_bounds,
    check_classes,
    check_count,
    check_goals,
    check_gradient,
    check_model,
    check_sizes,
)
from moireaug.attacks.losses import LOSSES, loss_curve
from moireaug.attacks.model import evaluating
from moireaug.attacks.problem import Point, Problem, Result
from moireaug.attacks.rules import RULES, Ball, Rule
from moireaug.attacks.task import ActiveImages, Task
from moireaug.image_checks import check_images
from moireaug.numeric import as_single
from moireaug.scene.fields import one_of
from moireaug.scenes import Shot


@dataclass(frozen=True, kw_only=True)
class Attack(ABC):
    """Projected gradient ascent on noise inside an L-infinity ball; subclasses say how noise
    becomes an image.

    A gradient of NaN counts as zero; with the rule "sign", that element of the noise stays where it
    is. Logits that become NaN or infinite count as no answer, which is never right and never the
    target: in an untargeted attack, such an image counts as fooled.

    Args:
        model: (B, 3, H, W) images in [0, 1] to (B, K) logits. Its mode, BatchNorm statistics and
            gradients are the same after the attack as before, even if it raises.
        eps: bound of the noise in [0, 1] units; a list gives one Result per value, in order.
        steps: gradient steps.
        step_size: in units of eps; None is min(1, 2.5 / steps), or 2 with the rule "apgd", and 1 /
            steps with "printed".
        rule: a key of `attacks.RULES`, the update of a step: "sign", "momentum", "apgd" or
            "printed".
        loss: a key of `attacks.LOSSES`: "ce", "margin" or "dlr"; each is targeted where there are
            targets.
        random_start: radius of the uniform random start, in units of eps; 0 starts from no noise.
            Above 1, allowed only with a single step, the noise may end outside the ball: N-FGSM (de
            Jorge et al., 2022).
        restarts: number of runs, the later ones from a random start; the best per image is kept.
        until_fooled: whether an image stops once it is fooled: just as many are fooled, in less
            time, by noise that goes less far beyond the decision boundary. If the model answers the
            same input differently when asked twice, every step is taken, because being fooled once
            says little.
    """

    model: nn.Module | Callable[[Tensor], Tensor] = field(kw_only=False)
    eps: float | Sequence[float] = 4 / 255
    steps: int = 20
    step_size: float | None = None
    rule: str = "sign"
    loss: str = "ce"
    random_start: float = 0.0
    restarts: int = 1
    until_fooled: bool = False

    def __post_init__(self) -> None:
        check_model(self.model)
        check_bounds(self.eps)
        if isinstance(self.eps, Real):  # NumPy's, for one
            object.__setattr__(self, "eps", float(self.eps))
        check_count("steps", self.steps, 0)
        check_count("restarts", self.restarts, 1)
        check_sizes(self.step_size, self.random_start, self.steps)
        one_of("rule", self.rule, RULES)
        one_of("loss", self.loss, LOSSES)

    @abstractmethod
    def problem(
        self, images: Tensor, shot: Shot | None, generator: torch.Generator | None
    ) -> Problem:
        """Return the problem of one batch: how noise becomes its images."""

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
            shot: the shot that is attacked; None draws one.
            generator: CPU generator of the draw and of random starts; None is torch's global one.

        Returns:
            A Result, or a list of them where `eps` is a list.

        Raises:
            TypeError, ValueError: images, labels or logits of the wrong type, shape or range;
                targets that equal their labels; a model without a gradient, or whose logits are not
                finite for any of the images.
        """
        images = check_images(images)
        with evaluating(self.model, images):
            images = images.detach().clone()
            labels, targets = check_goals(images, labels, targets)
            problem = self.problem(images, shot, generator)
            if isinstance(self.eps, (int, float)):
                return self._run(
                    Task(problem, labels, targets, targets, float(self.eps), generator)
                )
            results = []
            for eps in self.eps:
                task = Task(problem, labels, targets, targets, float(eps), generator)
                results.append(self._run(task))
            return results

    def toward(
        self,
        images: Tensor,
        labels: Tensor,
        classes: Tensor,
        *,
        shot: Shot | None = None,
        generator: torch.Generator | None = None,
        problem: Problem | None = None,
    ) -> Result:
        """Attack a batch by steps toward one class per image, where any wrong class is a success.

        Args:
            classes: (B,) int64 classes that the loss steers toward, as toward the `targets` of a
                call; the best point and success are as without targets.
            problem: problem of these images; None makes one.

        Other arguments and errors are as in a call; `eps` must be one number.
        """
        images, eps = check_images(images), self.single_eps()
        with evaluating(self.model, images):
            images = images.detach().clone()
            labels, loss_targets = check_goals(images, labels, classes)
            problem = problem or self.problem(images, shot, generator)
            return self._run(Task(problem, labels, None, loss_targets, eps, generator))

    def last(
        self,
        images: Tensor,
        labels: Tensor,
        *,
        shot: Shot | None = None,
        generator: torch.Generator | None = None,
    ) -> Tensor:
        """Return the images after the last step, (B, 3, H, W), whether or not an earlier step was
        better: adversarial training uses these, at exactly one forward and backward pass per step.
        Every step is taken, also for images already fooled. Arguments as in a call; `eps` must be
        one number."""
        images = check_images(images)
        with evaluating(self.model, images):
            images = images.detach().clone()
            labels, _ = check_goals(images, labels, None)
            problem = self.problem(images, shot, generator)
            task = Task(problem, labels, None, None, self.single_eps(), generator)
            point = self._ascend(task, self._start(task, restart=0), best=None)
        with torch.no_grad():
            return problem.render(**point).detach()

    def single_eps(self) -> float:
        """Return eps where it is one number, and refuse a list."""
        if not isinstance(self.eps, (int, float)):
            raise ValueError(
                f"eps must be one number here; got {self.eps!r}. Make one attack per value."
            )
        return float(self.eps)

    def _start(self, task: Task, restart: int) -> Point:
        """Return the starting point: no noise and the drawn pose, or random ones."""
        problem, radius = task.problem, self.random_start or (1.0 if restart else 0.0)
        device, dtype = problem.images.device, problem.images.dtype
        noise = torch.zeros(problem.shape, dtype=torch.float32, device="cpu")
        if radius and task.eps and "noise" not in problem.frozen:
            noise.uniform_(-radius * task.eps, radius * task.eps, generator=task.generator)
        noise = noise.to(device, torch.promote_types(dtype, torch.float32))
        if problem.mask is not None:
            noise = noise * problem.mask
        point = {"noise": noise}
        if problem.pose is not None:
            point["pose"] = problem.pose
            if restart:
                shape, dtype = problem.pose.shape, torch.float64
                fraction = torch.rand(shape, generator=task.generator, dtype=dtype, device="cpu")
                point["pose"] = (fraction * 2 - 1).to(device)
        return point

    def _rules(self, task: Task) -> dict[str, Rule]:
        """Return a rule for each variable that moves."""
        problem, eps = task.problem, task.eps
        # noise that starts outside the ball (N-FGSM) takes its step without being pulled back
        bound = eps if self.random_start <= 1 else math.inf
        noise = Ball(eps, bound, self.steps, self.step_size, problem.base, problem.effective_range)
        balls = {"noise": noise}
        if problem.pose is not None:
            balls["pose"] = Ball(1.0, 1.0, self.steps, self.step_size)
        rules = {}
        for name, ball in balls.items():
            if name not in problem.frozen:
                rules[name] = RULES[self.rule](ball)
        return rules

    def _ascend(self, task: Task, point: Point, best: BestPoints | None) -> Point:
        """Take the steps and return the last point; `best`, where given, keeps the best points and
        tells which images go on."""
        rules = self._rules(task)
        active = ActiveImages.of_all(task)
        for step in range(self.steps):
            if best and best.all_stopped:
                break
            if best:
                active = active.subset(best.active_rows())
            variables = {}
            for name, x in active.point(point).items():
                variables[name] = x.detach().requires_grad_(True)
            images = active.problem.forward_views(**variables)
            logits = self.model(images.clone())  # a model may work in place
            if step == 0:
                self._check(active, images, logits, best)
                check_gradient(logits)
            objective = LOSSES[self.loss](as_single(logits), *active.goals())
            # a scene may have ranges that no photo of it depends on
            gradients = torch.autograd.grad(
                objective.sum(), list(variables.values()), allow_unused=True
            )
            if step == 0:
                check_gradient(logits, gradients)
            point = {name: x.detach() for name, x in point.items()}
            if best:
                best.update(point, logits.detach(), active.rows)
            loss = active.scatter(objective.detach().view(active.problem.views, -1).mean(0))
            for (name, x), gradient in zip(list(point.items()), gradients, strict=True):
                if name in rules and gradient is not None:
                    # a NaN would stay in the point, and with it in every later image
                    point[name] = rules[name](x, active.scatter(gradient.nan_to_num()), loss)
        return point

    def _check(
        self, active: ActiveImages, images: Tensor, logits: Tensor, best: BestPoints | None
    ) -> None:
        """Refuse logits of the first step that do not match the labels, or of which none is finite,
        and ask the model twice where images stop once fooled."""
        classes, loss_targets = active.goals()
        if loss_targets is not None:
            classes = torch.maximum(classes, loss_targets)
        check_classes(classes, logits, 1)
        # in a later restart, the images that go on may well be those without an answer
        if len(active.rows) == len(active.task.labels):
            check_answers(logits, self.model, active.problem.images)
        if best and self.until_fooled:
            with torch.no_grad():
                second_logits = self.model(images)
            best.stops_fooled = torch.allclose(
                logits, second_logits, rtol=1e-3, atol=1e-3, equal_nan=True
            )

    def _run(self, task: Task) -> Result:
        """Run all restarts, and return the best point of each image."""
        problem, labels, targets = task.problem, task.labels, task.targets
        best = BestPoints(labels, targets, problem.views)
        for restart in range(self.restarts):
            if best.all_stopped:
                break
            best.losses = []
            point = self._ascend(task, self._start(task, restart), best)
            if not best.all_stopped:
                remaining = ActiveImages.of_all(task).subset(best.active_rows())
                with torch.no_grad():
                    images = remaining.problem.forward_views(**remaining.point(point))
                    best.update(point, self.model(images), remaining.rows)
        with torch.no_grad():
            photo = problem.render(**best.point)
            logits = self.model(photo.clone())
        check_answers(logits, self.model, problem.images)  # without steps, nothing was checked yet
        predictions = predicted(logits)
        success = predictions != labels if targets is None else predictions == targets
        losses = loss_curve(best.losses[: self.steps])
        shot = problem.shot_at(best.point["pose"]) if problem.shot_at else problem.shot
        return Result(photo.detach(), success, best.point["noise"], losses, task.eps, shot)
