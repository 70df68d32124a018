"""Attackers: conditions that search for noise that fools the model."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from moireaug.attacks import ATTACKS, MoireAttack, NoAnswerError
from moireaug.attacks.pose import searched_fields
from moireaug.attacks.problem import single
from moireaug.capture import capture
from moireaug.defenses import Defended
from moireaug.evaluation.conditions import Condition, EvalBatch, Model, codes
from moireaug.evaluation.judges import Judge
from moireaug.evaluation.visibility import visibility
from moireaug.mixtures import Mixture, scenes_of
from moireaug.scenes import Scene

DRAWS = 4  # of an expectation over shots, or over a randomised defence


@dataclass(frozen=True, kw_only=True)
class Attacker(Condition):
    """An attack at one bound.

    Args:
        eps: bound of the noise, in [0, 1] units. steps: gradient steps, or queries.
    """

    control: ClassVar[bool] = False
    on_screen: ClassVar[bool] = True  # the noise is on the reading of a photo

    eps: float
    steps: int

    @abstractmethod
    def attacked(self, batch: EvalBatch) -> Tensor:
        """Return what the attack shows.

        Raises:
            NoAnswerError: the model has no answer to any of the images.
        """

    @property
    def parts(self) -> int:
        """How many parts a batch is attacked in: an expectation over n draws takes n times the
        images, so that each step holds no more than a batch."""
        return 1

    def show(self, batch: EvalBatch) -> Tensor:
        size = -(-len(batch.images) // self.parts)
        shown = []
        for first in range(0, len(batch.images), size):
            part = batch[first : first + size]
            try:
                shown.append(self.attacked(part))
            except NoAnswerError:  # wrong without an attack: the evaluation goes on
                shown.append(self.start(part))
        return torch.cat(shown)

    def start(self, batch: EvalBatch) -> Tensor:
        """Return what the attack starts from."""
        return capture(batch.images, batch.shot) if self.on_screen else batch.images

    def goals(self, batch: EvalBatch) -> tuple[Tensor, Tensor | None]:
        """Return the labels, and the targets where the attack is targeted."""
        return batch.labels, batch.targets if self.targeted else None

    def measure(self, batch: EvalBatch, shown: Tensor) -> dict[str, list[float]]:
        return visibility(shown, self.start(batch), batch.lpips)


@dataclass(frozen=True, kw_only=True)
class MoireAttacker(Attacker):
    """The Moiré Attack on the very shot that is judged.

    Args:
        variant: what distinguishes this attacker from the plain one; part of its name.
        rule, loss, restarts, noise_at, optimise: as of `attacks.MoireAttack`.
        until_fooled: the same; False where other judges see the noise, or where it is measured at
            its strongest.
        knows: the defence that it attacks through, with the defence's own approximate gradient
            (BPDA) and by expectation over its draws where it is randomised (EOT).
    """

    kind = "ma"
    variant: str = ""
    rule: str = "sign"
    loss: str = "ce"
    restarts: int = 1
    noise_at: str = "raw"
    optimise: tuple[str, ...] = ("noise",)
    until_fooled: bool = True
    knows: Judge | None = None

    @property
    def base_name(self) -> str:
        kind = ["targeted"] if self.targeted else []
        if self.variant:
            kind.append(self.variant)
        return _name("ma", self.eps, *kind, until_fooled=self.until_fooled)

    @property
    def parts(self) -> int:
        return draws_of(self.knows)

    def attacked(self, batch: EvalBatch) -> Tensor:
        attack = MoireAttack(
            model=through(self.knows, batch.model),
            scene=batch.shot.scene,
            eps=self.eps,
            steps=self.steps,
            rule=self.rule,
            loss=self.loss,
            restarts=self.restarts,
            noise_at=self.noise_at,
            optimise=self.optimise,
            until_fooled=self.until_fooled,
        )
        goals = self.goals(batch)
        return single(
            attack(batch.images, *goals, shot=batch.shot, generator=batch.generator)
        ).images

    def measure(self, batch: EvalBatch, shown: Tensor) -> dict[str, list[float]]:
        if self.optimise != ("noise",):  # there is no photo of the same pose to compare with
            return {}
        return super().measure(batch, shown)

    def settings(self) -> dict[str, Any]:
        return super().settings() | known_defence(self.knows)


class PoseUnknown(Attacker):
    """Noise found by expectation over other draws of the scene, shown on the shot that is
    judged."""

    kind = "blind"

    @property
    def base_name(self) -> str:
        return f"blind_{codes(self.eps)}"

    @property
    def parts(self) -> int:
        return DRAWS

    def attacked(self, batch: EvalBatch) -> Tensor:
        attack = MoireAttack(
            model=batch.model,
            scene=batch.shot.scene,
            eps=self.eps,
            steps=self.steps,
            eot=DRAWS,
        )
        result = single(attack(batch.images, *self.goals(batch), generator=batch.generator))
        return capture(batch.images, batch.shot, result.noise)


@dataclass(frozen=True, kw_only=True)
class PixelAttacker(Attacker):
    """An attack on the pixels of the image, without a camera, for comparison.

    Args:
        attack: a key of `attacks.ATTACKS`: "pgd", "bim", "mifgsm" or "patch"; or "cw", which has no
            bound and whose eps is 0.
        until_fooled: as of `MoireAttacker`; "cw" takes every step.
    """

    kind = "pixels"
    on_screen: ClassVar[bool] = False
    attack: str
    until_fooled: bool = True

    @property
    def base_name(self) -> str:
        if self.attack == "cw":
            return self.attack
        return _name(self.attack, self.eps, until_fooled=self.until_fooled)

    def attacked(self, batch: EvalBatch) -> Tensor:
        settings: dict[str, Any] = {"steps": self.steps}
        if self.attack != "cw":
            settings |= {"eps": self.eps, "until_fooled": self.until_fooled}
        attack = ATTACKS[self.attack](model=batch.model, **settings)
        goals = self.goals(batch)
        return single(attack(batch.images, *goals, generator=batch.generator)).images


def _name(attack: str, eps: float, *kind: str, until_fooled: bool) -> str:
    parts = [attack, codes(eps), *kind]
    if not until_fooled:
        parts.append("in_every_step")
    return "_".join(parts)


def draws_of(knows: Judge | None) -> int:
    """Return how many draws of a defence an attacker averages over: several where it is
    randomised."""
    randomised = knows is not None and getattr(knows.defence, "randomised", False)
    return DRAWS if randomised else 1


def through(knows: Judge | None, model: Model) -> Model:
    """Return what is attacked: the model, behind the defence that the attacker knows of."""
    if knows is None or knows.defence is None:
        return model
    return Defended(model, knows.defence, draws=draws_of(knows))


def known_defence(knows: Judge | None) -> dict[str, str]:
    """Return what identifies the defence that an attacker knows of, for its settings."""
    return {} if knows is None else {"knows": knows.identity}


def turnable(scene: Scene | Mixture) -> tuple[tuple[str, ...], str]:
    """Return which of view and panel an attacker can move, in every scene of a mixture, and, where
    it is none, why."""
    found, why = [], ""
    for part in ("view", "panel"):
        try:
            for one in scenes_of(scene):
                searched_fields(one, (part,))
            found.append(part)
        except ValueError as error:
            why = why or str(error)
    return tuple(found), "" if found else why
