"""An attack run toward several classes in turn: MultiTargeted, and with it AutoAttack's APGD-T."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

import torch
from torch import Tensor

from moireaug.attacks.answers import predicted
from moireaug.attacks.checks import check_answers, check_classes, check_count, check_goals
from moireaug.attacks.loop import Attack
from moireaug.attacks.losses import likeliest_wrong_classes, loss_curve, margin
from moireaug.attacks.mixed import drawn_shot, join_results, split_by_scene
from moireaug.attacks.model import evaluating
from moireaug.attacks.moire import MoireAttack
from moireaug.attacks.problem import Problem, Result, noise_tensor
from moireaug.image_checks import check_images
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
        targets: number of classes, the likeliest first; where the model has no more than that, all
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
            return self._attack_scene(images, labels, drawn, generator)
        batches = split_by_scene(drawn, images, *check_goals(images, labels, None))
        results = [self._attack_scene(b.images, b.labels, b.shot, generator) for b in batches]
        return join_results(drawn, batches, results, noise_at)

    def _attack_scene(
        self, images: Tensor, labels: Tensor, shot: Shot | None, generator: torch.Generator | None
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
            results = []
            for one_eps in eps:
                attack = dataclasses.replace(self.attack, eps=one_eps)
                results.append(self._run(attack, problem, labels, generator))
            return results

    def _run(
        self, attack: Attack, problem: Problem, labels: Tensor, generator: torch.Generator | None
    ) -> Result:
        images, shot = problem.images, problem.shot
        best, logits = _without_noise(attack, problem, labels)
        best_margin = margin(logits.float(), labels)
        values, classes = likeliest_wrong_classes(logits, labels, self.targets)
        for value, targets in zip(values.T, classes.T, strict=True):
            # images that are still right, and whose class minus infinity does not rule out
            rows = (~best.success & value.isfinite()).nonzero()[:, 0]
            if not len(rows):
                break
            rows_shot = None if shot is None else shot[rows.to(shot.device)]
            subset = problem.subset(rows) if problem.views == 1 else None
            result = attack.toward(
                images[rows],
                labels[rows],
                targets[rows],
                shot=rows_shot,
                generator=generator,
                problem=subset,
            )
            with torch.no_grad():
                margins = margin(attack.model(result.images.clone()).float(), labels[rows])
            better = result.success | (margins > best_margin[rows])
            best_margin[rows] = torch.where(better, margins, best_margin[rows])
            best = _with_rows(best, rows[better], result, better)
        return best


def _without_noise(attack: Attack, problem: Problem, labels: Tensor) -> tuple[Result, Tensor]:
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
    eps = attack.single_eps()
    return Result(photo, success, point["noise"], loss_curve([]), eps, problem.shot), logits


def _with_rows(result: Result, rows: Tensor, other: Result, selected: Tensor) -> Result:
    """Replace `rows` of one result by the rows of another in the mask `selected`."""
    shot = result.shot
    if isinstance(shot, Shot) and isinstance(other.shot, Shot):
        new_rows = other.shot[selected.to(other.shot.device)]
        shot = _shot_with_rows(shot, rows.to(shot.device), new_rows)
    return Result(
        result.images.index_copy(0, rows, other.images[selected]),
        result.success.index_copy(0, rows, other.success[selected]),
        noise_tensor(result).index_copy(0, rows, noise_tensor(other)[selected]),
        other.loss,
        result.eps,
        shot,
    )


def _shot_with_rows(shot: Shot, rows: Tensor, other: Shot) -> Shot:
    """Replace the numbers drawn for some rows of a shot by those of another."""
    new, numbers = other.to(shot.device).numbers(), {}
    for name, values in shot.numbers().items():
        numbers[name] = values.index_copy(0, rows, new[name])
    return dataclasses.replace(shot, **parts_with(shot, numbers))
