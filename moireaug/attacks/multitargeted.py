"""An attack run toward several classes in turn: MultiTargeted, and with it AutoAttack's APGD-T."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from functools import partial

import torch
from torch import Tensor

from moireaug.attacks.answers import predicted
from moireaug.attacks.checks import check_answers, check_classes, check_count, check_goals
from moireaug.attacks.loop import Attack
from moireaug.attacks.losses import likeliest, loss_curve, margin
from moireaug.attacks.mixed import as_one, by_scene, drawn_shot
from moireaug.attacks.model import evaluating
from moireaug.attacks.moire import MoireAttack
from moireaug.attacks.problem import Problem, Result, noise_tensor
from moireaug.checks import check_images
from moireaug.mixed_shot import MixedShot
from moireaug.mixtures import as_scenes
from moireaug.scene.by_name import parts_with
from moireaug.scenes import Shot


@dataclass(frozen=True, kw_only=True)
class MultiTargeted:
    """Run an attack toward each of the likeliest wrong classes of the unattacked photo in turn
    (Gowal et al., 2019).

    Any wrong class is a success. An image is done at its first success; for the others the greatest
    margin is kept. With the rule "apgd" and the loss "dlr" it is APGD-T, the second attack of
    AutoAttack (Croce & Hein, 2020, section 5): `MultiTargeted(MoireAttack(model, rule="apgd",
    loss="dlr", steps=100))`.

    Args:
        attack: a MoireAttack, PGD or another `Attack`, whose loss steers toward the class.
        targets: how many classes, the likeliest first; where the model has no more than that, all
            but the label.

    Raises:
        TypeError, ValueError: another kind of attack, or `targets` that is not an integer >= 1.
    """

    attack: Attack = field(kw_only=False)
    targets: int = 9

    def __post_init__(self) -> None:
        if not isinstance(self.attack, Attack):
            raise TypeError(
                "MultiTargeted runs an attack whose steps have a target, like MoireAttack or PGD; "
                f"got {self.attack!r}."
            )
        check_count("targets", self.targets, 1, "the classes to go toward")

    def __call__(
        self,
        images: Tensor,
        labels: Tensor,
        *,
        shot: Shot | MixedShot | None = None,
        generator: torch.Generator | None = None,
    ) -> Result | list[Result]:
        """Attack a batch; arguments, Result and errors as of `Attack`, without targets.

        Photos that are wrong without an attack are returned unchanged. `loss` in the Result is of
        the last class that was tried, over the images that were left.
        """
        scene, noise_at = None, "raw"
        if isinstance(self.attack, MoireAttack):
            scene, noise_at = as_scenes(self.attack.scene), self.attack.noise_at
        drawn = drawn_shot(scene, images, shot, generator)
        if not isinstance(drawn, MixedShot):
            return self._in_one(images, labels, shot=drawn, generator=generator)
        goals = check_goals(images, labels, None)[:1]
        in_one = partial(self._in_one, generator=generator)
        return as_one(drawn, by_scene(drawn, images, goals, in_one), noise_at)

    def _in_one(
        self,
        images: Tensor,
        labels: Tensor,
        *,
        shot: Shot | None,
        generator: torch.Generator | None,
    ) -> Result | list[Result]:
        """Attack a batch of one scene."""
        images = check_images(images)
        eps = self.attack.eps
        with evaluating(self.attack.model, images):
            images = images.detach().clone()
            labels, _ = check_goals(images, labels, None)
            problem = self.attack.problem(images, shot, generator)
            if isinstance(eps, (int, float)):
                return self._run(self.attack, problem, labels, generator)
            ladder = [dataclasses.replace(self.attack, eps=e) for e in eps]
            return [self._run(attack, problem, labels, generator) for attack in ladder]

    def _run(
        self, attack: Attack, problem: Problem, labels: Tensor, generator: torch.Generator | None
    ) -> Result:
        images, shot = problem.images, problem.shot
        found, logits = _unattacked(attack, problem, labels)
        best = margin(logits.float(), labels)
        values, classes = likeliest(logits, labels, self.targets)
        for value, toward in zip(values.T, classes.T, strict=True):
            # those that are still right, and toward no class that minus infinity rules out
            rows = (~found.success & value.isfinite()).nonzero()[:, 0]
            if not len(rows):
                break
            own = None if shot is None else shot[rows.to(shot.device)]
            part = problem.part(rows) if problem.views == 1 else None
            result = attack.toward(
                images[rows],
                labels[rows],
                toward[rows],
                shot=own,
                generator=generator,
                problem=part,
            )
            with torch.no_grad():
                reached = margin(attack.model(result.images.clone()).float(), labels[rows])
            better = result.success | (reached > best[rows])
            best[rows] = torch.where(better, reached, best[rows])
            found = _with_rows(found, rows[better], result, better)
        return found


def _unattacked(attack: Attack, problem: Problem, labels: Tensor) -> tuple[Result, Tensor]:
    """Return the photos without noise at the drawn pose as a Result, and their logits (B, K)."""
    images = problem.images
    dtype = torch.float64 if images.dtype == torch.float64 else torch.float32
    point = {"noise": torch.zeros(problem.shape, dtype=dtype, device=images.device)}
    if problem.pose is not None:
        point["pose"] = problem.pose
    with torch.no_grad():
        photo = problem.render(**point)
        logits = attack.model(photo.clone())
    check_classes(labels, logits, 1)
    check_answers(logits, attack.model, images)
    success = predicted(logits) != labels
    found = Result(photo, success, point["noise"], loss_curve([]), attack.one_eps(), problem.shot)
    return found, logits


def _with_rows(found: Result, rows: Tensor, other: Result, picked: Tensor) -> Result:
    """Replace `rows` of one result by those of another that the mask `picked` selects."""
    shot = found.shot
    if isinstance(shot, Shot) and isinstance(other.shot, Shot):
        shot = _shot_with_rows(shot, rows.to(shot.device), other.shot[picked.to(other.shot.device)])
    return Result(
        found.images.index_copy(0, rows, other.images[picked]),
        found.success.index_copy(0, rows, other.success[picked]),
        noise_tensor(found).index_copy(0, rows, noise_tensor(other)[picked]),
        other.loss,
        found.eps,
        shot,
    )


def _shot_with_rows(shot: Shot, rows: Tensor, other: Shot) -> Shot:
    """Replace the numbers drawn for some rows of a shot by those of another."""
    new, numbers = other.to(shot.device).numbers(), {}
    for name, values in shot.numbers().items():
        numbers[name] = values.index_copy(0, rows, new[name])
    return dataclasses.replace(shot, **parts_with(shot, numbers))
