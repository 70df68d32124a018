"""The attackers of AutoAttack (Croce & Hein, 2020) on the raw reading: APGD-CE, APGD-T and
Square."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from moireaug.attacks import MoireAttack, MultiTargeted, SquareMoire, evaluating
from moireaug.attacks.problem import single
from moireaug.evaluation.attackers import Attacker, draws_of, known_defence, through
from moireaug.evaluation.conditions import EvalBatch, codes
from moireaug.evaluation.judges import Judge

CLASSES = 9  # that APGD-T goes toward


class TargetedApgd(Attacker):
    """APGD-T on the raw reading: see `toward_classes`."""

    kind = "apgd_t"

    @property
    def base_name(self) -> str:
        return f"apgd_t_{codes(self.eps)}"

    def attacked(self, batch: EvalBatch) -> Tensor:
        return toward_classes(batch, self.eps, self.steps, CLASSES)


@dataclass(frozen=True, kw_only=True)
class Apgd(Attacker):
    """APGD on the raw reading in the order of AutoAttack: on the cross-entropy, and then, on the
    images that are still right, APGD-T.

    Args:
        classes: how many APGD-T goes toward, the likeliest first.
        knows: as of `MoireAttacker`.
    """

    kind = "apgd"
    classes: int = CLASSES
    knows: Judge | None = None

    @property
    def base_name(self) -> str:
        name = f"apgd_{codes(self.eps)}"
        return name if self.knows is None else f"{name}_through_{self.knows.name}"

    @property
    def parts(self) -> int:
        return draws_of(self.knows)

    def attacked(self, batch: EvalBatch) -> Tensor:
        batch = dataclasses.replace(batch, model=through(self.knows, batch.model))
        first = MoireAttack(
            model=batch.model,
            scene=batch.shot.scene,
            eps=self.eps,
            steps=self.steps,
            rule="apgd",
            until_fooled=True,
        )
        found = single(
            first(batch.images, batch.labels, shot=batch.shot, generator=batch.generator)
        )
        right = (~found.success).nonzero()[:, 0]
        if not len(right):
            return found.images
        second = toward_classes(batch[right], self.eps, self.steps, self.classes)
        return found.images.index_copy(0, right, second)

    def settings(self) -> dict[str, Any]:
        return super().settings() | known_defence(self.knows)


class SquareAttacker(Attacker):
    """A search without gradients, on the raw reading; `steps` are queries."""

    kind = "square"

    @property
    def base_name(self) -> str:
        return f"square_{codes(self.eps)}"

    def attacked(self, batch: EvalBatch) -> Tensor:
        scene = batch.shot.scene
        attack = SquareMoire(
            model=batch.model, scene=scene, eps=self.eps, steps=self.steps, until_fooled=True
        )
        goals = self.goals(batch)
        return single(
            attack(batch.images, *goals, shot=batch.shot, generator=batch.generator)
        ).images


def toward_classes(batch: EvalBatch, eps: float, steps: int, classes: int) -> Tensor:
    """Return what APGD-T shows: APGD toward each of the likeliest other classes in turn, by the
    targeted DLR loss; a model of fewer than four classes has no such loss, and is attacked by the
    margin."""
    with evaluating(batch.model, batch.images), torch.no_grad():
        logits = batch.model(batch.images[:1].clone())
    attack = MoireAttack(
        model=batch.model,
        scene=batch.shot.scene,
        eps=eps,
        steps=steps,
        rule="apgd",
        loss="dlr" if logits.shape[1] >= 4 else "margin",
        until_fooled=True,
    )
    toward = MultiTargeted(attack, targets=classes)
    return single(
        toward(batch.images, batch.labels, shot=batch.shot, generator=batch.generator)
    ).images
