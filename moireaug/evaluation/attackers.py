"""Attackers: conditions that search for noise that fools the model."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from moireaug.attacks import ATTACKS, MoireAttack, NoAnswerError
from moireaug.attacks.pose import searched_fields
from moireaug.attacks.result import Result
from moireaug.capture import capture
from moireaug.defenses import Defended
from moireaug.evaluation.conditions import Condition, EvalBatch, Model, codes
from moireaug.evaluation.judges import Judge
from moireaug.evaluation.visibility import visibility
from moireaug.mixtures import Mixture, scenes_of
from moireaug.scenes import Scene

EOT_SHOTS = 4  # shots that a noise for an unknown pose is optimised over
DEFENCE_DRAWS = 4  # draws of a randomised defence that an attack through it averages over


@dataclass(frozen=True, kw_only=True)
class Attacker(Condition):
    """An attack at one bound.

    Args:
        eps: bound of the noise, in [0, 1] units.
        steps: number of gradient steps, or of queries.
    """

    control: ClassVar[bool] = False
    on_screen: ClassVar[bool] = True  # the noise is on the reading of a photo

    eps: float
    steps: int

    @abstractmethod
    def perturb(self, batch: EvalBatch) -> Tensor:
        """Return the adversarial images, (B, 3, H, W).

        Raises:
            NoAnswerError: the model has no answer to any of the images.
        """

    @property
    def n_splits(self) -> int:
        """Number of splits of a batch that are attacked in turn: an expectation over n draws takes
        n times the images, and no step shall hold more than a batch."""
        return 1

    def show(self, batch: EvalBatch) -> Tensor:
        size = -(-len(batch.images) // self.n_splits)
        images = []
        for first in range(0, len(batch.images), size):
            split = batch[first : first + size]
            try:
                images.append(self.perturb(split))
            except NoAnswerError:  # wrong without an attack: the evaluation goes on
                images.append(self.unattacked(split))
        return torch.cat(images)

    def unattacked(self, batch: EvalBatch) -> Tensor:
        """Return the images without an attack."""
        return capture(batch.images, batch.shot) if self.on_screen else batch.images

    def goals(self, batch: EvalBatch) -> tuple[Tensor, Tensor | None]:
        """Return the labels, and the targets of a targeted attack."""
        return batch.labels, batch.targets if self.targeted else None

    def measure(self, batch: EvalBatch, images: Tensor) -> dict[str, list[float]]:
        return visibility(images, self.unattacked(batch), batch.lpips)


@dataclass(frozen=True, kw_only=True)
class MoireAttacker(Attacker):
    """The Moiré Attack on the very shot that is judged.

    Args:
        variant: word that the name of a special attacker adds.
        rule, loss, restarts, noise_at, optimise: as of `attacks.MoireAttack`.
        until_fooled: the same; False where other judges see the noise, or where it is measured at
            its strongest.
        knows: judge whose defence is attacked, with the defence's own approximate gradient (BPDA)
            and by expectation over its draws where it is randomised (EOT).
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
        return _attack_name("ma", self.eps, *kind, until_fooled=self.until_fooled)

    @property
    def n_splits(self) -> int:
        return defence_draws(self.knows)

    def perturb(self, batch: EvalBatch) -> Tensor:
        attack = MoireAttack(
            model=behind_defence(self.knows, batch.model),
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
        return attack_shot(attack, batch, *self.goals(batch)).images

    def measure(self, batch: EvalBatch, images: Tensor) -> dict[str, list[float]]:
        if self.optimise != ("noise",):  # there is no photo of the same pose to compare with
            return {}
        return super().measure(batch, images)

    def settings(self) -> dict[str, Any]:
        return super().settings() | known_defence(self.knows)


class PoseUnknown(Attacker):
    """The Moiré Attack by expectation over other draws of the scene, shown on the shot that is
    judged."""

    kind = "blind"

    @property
    def base_name(self) -> str:
        return f"blind_{codes(self.eps)}"

    @property
    def n_splits(self) -> int:
        return EOT_SHOTS

    def perturb(self, batch: EvalBatch) -> Tensor:
        attack = MoireAttack(
            model=batch.model,
            scene=batch.shot.scene,
            eps=self.eps,
            steps=self.steps,
            eot=EOT_SHOTS,
        )
        result = attack(batch.images, *self.goals(batch), generator=batch.generator)
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
        return _attack_name(self.attack, self.eps, until_fooled=self.until_fooled)

    def perturb(self, batch: EvalBatch) -> Tensor:
        settings: dict[str, Any] = {"steps": self.steps}
        if self.attack != "cw":
            settings |= {"eps": self.eps, "until_fooled": self.until_fooled}
        attack = ATTACKS[self.attack](model=batch.model, **settings)
        goals = self.goals(batch)
        return attack(batch.images, *goals, generator=batch.generator).images


def attack_shot(attack: Callable[..., Result], batch: EvalBatch, *goals: Tensor | None) -> Result:
    """Return the result of an attack on the batch's own shot."""
    return attack(batch.images, *goals, shot=batch.shot, generator=batch.generator)


def _attack_name(attack: str, eps: float, *variants: str, until_fooled: bool) -> str:
    words = [attack, codes(eps), *variants]
    if not until_fooled:
        words.append("in_every_step")
    return "_".join(words)


def defence_draws(knows: Judge | None) -> int:
    """Return the number of draws of a defence that an attacker averages over: several where it is
    randomised."""
    randomised = knows is not None and getattr(knows.defence, "randomised", False)
    return DEFENCE_DRAWS if randomised else 1


def behind_defence(knows: Judge | None, model: Model) -> Model:
    """Return the attacked model, behind the defence that the attacker knows of."""
    if knows is None or knows.defence is None:
        return model
    return Defended(model, knows.defence, draws=defence_draws(knows))


def known_defence(knows: Judge | None) -> dict[str, str]:
    """Return the identity of the defence that an attacker knows of, for its settings."""
    return {} if knows is None else {"knows": knows.identity}


def movable_parts(scene: Scene | Mixture) -> tuple[tuple[str, ...], str]:
    """Return the parts, of view and panel, that an attacker can search in every scene of a mixture,
    and, where there is none, the reason."""
    parts, reason = [], ""
    for part in ("view", "panel"):
        try:
            for one in scenes_of(scene):
                searched_fields(one, (part,))
            parts.append(part)
        except ValueError as error:
            reason = reason or str(error)
    return tuple(parts), "" if parts else reason
