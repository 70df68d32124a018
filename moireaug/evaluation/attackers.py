"""Attackers: conditions in which somebody searches for what fools the model."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from moireaug.attacks import (
    ATTACKS,
    MoireAttack,
    MultiTargeted,
    NoAnswerError,
    SquareMoire,
    evaluating,
)
from moireaug.attacks.pose import moved_fields
from moireaug.attacks.problem import single
from moireaug.capture import capture
from moireaug.defenses import Defended
from moireaug.evaluation.conditions import Condition, EvalBatch, codes
from moireaug.evaluation.visibility import visibility
from moireaug.scene.scene import Scene

DRAWS = 4  # of an expectation over shots, or over a randomised defence
Defence = Callable[[Tensor], Tensor]


@dataclass(frozen=True, kw_only=True)
class Attacker(Condition):
    """An attack at one bound.

    Args:
        eps: bound of the noise, in [0, 1] units. steps: gradient steps, or queries.
    """

    control: ClassVar[bool] = False

    eps: float
    steps: int

    def goals(self, batch: EvalBatch) -> tuple[Tensor, Tensor | None]:
        """Return the labels, and the targets where the attack is targeted."""
        return batch.labels, batch.targets if self.targeted else None


@dataclass(frozen=True, kw_only=True)
class MoireAttacker(Attacker):
    """The Moiré Attack on the very shot that is judged.

    Args:
        variant: what tells this attacker from the plain one, part of its name.
        rule, loss, restarts, noise_at, optimise: as of `attacks.MoireAttack`.
        knows: name of the defence that it attacks through, by the defence's own approximation of
            the gradient (BPDA) and by expectation over its draws where it is randomised (EOT).
        defence: that defence.
    """

    kind = "ma"
    variant: str = ""
    rule: str = "sign"
    loss: str = "ce"
    restarts: int = 1
    noise_at: str = "raw"
    optimise: tuple[str, ...] = ("noise",)
    knows: str = ""
    defence: Defence | None = None

    @property
    def base_name(self) -> str:
        name = f"ma_{codes(self.eps)}"
        if self.targeted:
            name += "_targeted"
        if self.variant:
            name += f"_{self.variant}"
        return name

    def show(self, batch: EvalBatch) -> Tensor:
        if self.defence is None:
            return self._attacked(batch)
        draws = DRAWS if getattr(self.defence, "randomised", False) else 1
        through = Defended(batch.model, self.defence, draws=draws)
        return in_parts(self._attacked, dataclasses.replace(batch, model=through), draws)

    def _attacked(self, batch: EvalBatch) -> Tensor:
        attack = MoireAttack(
            model=batch.model,
            scene=batch.shot.scene,
            eps=self.eps,
            steps=self.steps,
            rule=self.rule,
            loss=self.loss,
            restarts=self.restarts,
            noise_at=self.noise_at,
            optimise=self.optimise,
        )
        try:
            result = single(
                attack(batch.images, *self.goals(batch), shot=batch.shot, generator=batch.generator)
            )
        except NoAnswerError:  # these images are wrong without an attack, and an evaluation goes on
            return capture(batch.images, batch.shot)
        return result.images

    def measure(self, batch: EvalBatch, shown: Tensor) -> dict[str, list[float]]:
        if self.optimise != ("noise",):  # there is no photo of the same pose to compare with
            return {}
        return visibility(shown, capture(batch.images, batch.shot))

    def settings(self) -> dict[str, Any]:
        found = super().settings()
        del found["defence"]  # `knows` stands for it
        return found


class TargetedApgd(Attacker):
    """APGD-T on the raw reading: APGD toward each of the nine likeliest other classes in turn, by
    the targeted DLR loss; a model of fewer than four classes has no such loss, and is attacked by
    the margin."""

    kind = "apgd_t"

    @property
    def base_name(self) -> str:
        return f"apgd_t_{codes(self.eps)}"

    def show(self, batch: EvalBatch) -> Tensor:
        with evaluating(batch.model), torch.no_grad():
            classes = batch.model(batch.images[:1]).shape[1]
        attack = MoireAttack(
            model=batch.model,
            scene=batch.shot.scene,
            eps=self.eps,
            steps=self.steps,
            rule="apgd",
            loss="dlr" if classes >= 4 else "margin",
        )
        try:
            toward = MultiTargeted(attack)
            result = single(
                toward(batch.images, batch.labels, shot=batch.shot, generator=batch.generator)
            )
        except NoAnswerError:
            return capture(batch.images, batch.shot)
        return result.images

    def measure(self, batch: EvalBatch, shown: Tensor) -> dict[str, list[float]]:
        return visibility(shown, capture(batch.images, batch.shot))


class PoseUnknown(Attacker):
    """Noise that was found by expectation over other draws of the scene, on the shot that is
    judged."""

    kind = "blind"

    @property
    def base_name(self) -> str:
        return f"blind_{codes(self.eps)}"

    def show(self, batch: EvalBatch) -> Tensor:
        return in_parts(self._attacked, batch, DRAWS)

    def _attacked(self, batch: EvalBatch) -> Tensor:
        attack = MoireAttack(
            model=batch.model,
            scene=batch.shot.scene,
            eps=self.eps,
            steps=self.steps,
            eot=DRAWS,
        )
        try:
            result = single(attack(batch.images, *self.goals(batch), generator=batch.generator))
        except NoAnswerError:
            return capture(batch.images, batch.shot)
        return capture(batch.images, batch.shot, result.noise)

    def measure(self, batch: EvalBatch, shown: Tensor) -> dict[str, list[float]]:
        return visibility(shown, capture(batch.images, batch.shot))


class SquareAttacker(Attacker):
    """A search without gradients, on the raw reading; `steps` are queries."""

    kind = "square"

    @property
    def base_name(self) -> str:
        return f"square_{codes(self.eps)}"

    def show(self, batch: EvalBatch) -> Tensor:
        attack = SquareMoire(
            model=batch.model, scene=batch.shot.scene, eps=self.eps, steps=self.steps
        )
        try:
            result = single(
                attack(batch.images, *self.goals(batch), shot=batch.shot, generator=batch.generator)
            )
        except NoAnswerError:
            return capture(batch.images, batch.shot)
        return result.images

    def measure(self, batch: EvalBatch, shown: Tensor) -> dict[str, list[float]]:
        return visibility(shown, capture(batch.images, batch.shot))


@dataclass(frozen=True, kw_only=True)
class PixelAttacker(Attacker):
    """A rival that perturbs the pixels of the image, which no camera saw.

    Args:
        attack: a key of `attacks.ATTACKS`: "pgd", "bim", "mifgsm" or "cw", which has no bound.
    """

    kind = "pixels"
    attack: str

    @property
    def base_name(self) -> str:
        return self.attack if self.attack == "cw" else f"{self.attack}_{codes(self.eps)}"

    def show(self, batch: EvalBatch) -> Tensor:
        settings: dict[str, Any] = {"steps": self.steps}
        if self.attack != "cw":
            settings["eps"] = self.eps
        attack = ATTACKS[self.attack](model=batch.model, **settings)
        try:
            result = single(attack(batch.images, *self.goals(batch), generator=batch.generator))
        except NoAnswerError:
            return batch.images
        return result.images

    def measure(self, batch: EvalBatch, shown: Tensor) -> dict[str, list[float]]:
        return visibility(shown, batch.images)


def in_parts(show: Callable[[EvalBatch], Tensor], batch: EvalBatch, n: int) -> Tensor:
    """Show a batch in n parts: an expectation over n draws holds n times the images, and so no more
    than a batch."""
    size = -(-len(batch.images) // n)
    shown = [show(batch[i : i + size]) for i in range(0, len(batch.images), size)]
    return torch.cat(shown)


def turnable(scene: Scene) -> tuple[tuple[str, ...], str]:
    """Return which of view and panel an attacker can turn, and, where it is none, why."""
    found, why = [], ""
    for part in ("view", "panel"):
        try:
            moved_fields(scene, (part,))
            found.append(part)
        except ValueError as error:
            why = why or str(error)
    return tuple(found), "" if found else why
