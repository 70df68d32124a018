"""The attackers of AutoAttack (Croce & Hein, 2020) on the raw reading: APGD-CE, APGD-T and
Square."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from moireaug.attacks import MoireAttack, MultiTargeted, SquareMoire, evaluating
from moireaug.evaluation.attackers import (
    Attacker,
    attack_shot,
    behind_defence,
    defence_draws,
    known_defence,
)
from moireaug.evaluation.conditions import EvalBatch, codes
from moireaug.evaluation.judges import Judge

N_TARGET_CLASSES = 9  # of APGD-T


class TargetedApgd(Attacker):
    """APGD-T on the raw reading: see `perturb_toward_classes`."""

    kind = "apgd_t"

    @property
    def base_name(self) -> str:
        return f"apgd_t_{codes(self.eps)}"

    def perturb(self, batch: EvalBatch) -> Tensor:
        return perturb_toward_classes(batch, self.eps, self.steps, N_TARGET_CLASSES)


@dataclass(frozen=True, kw_only=True)
class Apgd(Attacker):
    """APGD on the raw reading in the order of AutoAttack: on the cross-entropy, and then, on the
    images that are still right, APGD-T.

    Args:
        classes: number of target classes of APGD-T, the likeliest first.
        knows: as of `MoireAttacker`.
    """

    kind = "apgd"
    classes: int = N_TARGET_CLASSES
    knows: Judge | None = None

    @property
    def base_name(self) -> str:
        name = f"apgd_{codes(self.eps)}"
        return name if self.knows is None else f"{name}_through_{self.knows.name}"

    @property
    def n_splits(self) -> int:
        return defence_draws(self.knows)

    def perturb(self, batch: EvalBatch) -> Tensor:
        batch = dataclasses.replace(batch, model=behind_defence(self.knows, batch.model))
        first = MoireAttack(
            model=batch.model,
            scene=batch.shot.scene,
            eps=self.eps,
            steps=self.steps,
            rule="apgd",
            until_fooled=True,
        )
        result = attack_shot(first, batch, batch.labels)
        still_right = (~result.success).nonzero()[:, 0]
        if not len(still_right):
            return result.images
        images = perturb_toward_classes(batch[still_right], self.eps, self.steps, self.classes)
        return result.images.index_copy(0, still_right, images)

    def settings(self) -> dict[str, Any]:
        return super().settings() | known_defence(self.knows)


class SquareAttacker(Attacker):
    """A search without gradients, on the raw reading; `steps` are queries."""

    kind = "square"

    @property
    def base_name(self) -> str:
        return f"square_{codes(self.eps)}"

    def perturb(self, batch: EvalBatch) -> Tensor:
        scene = batch.shot.scene
        attack = SquareMoire(
            model=batch.model, scene=scene, eps=self.eps, steps=self.steps, until_fooled=True
        )
        return attack_shot(attack, batch, *self.goals(batch)).images


def perturb_toward_classes(batch: EvalBatch, eps: float, steps: int, classes: int) -> Tensor:
    """Return the images of APGD-T: APGD toward each of the likeliest other classes in turn, by the
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
    multitargeted = MultiTargeted(attack, targets=classes)
    return attack_shot(multitargeted, batch, batch.labels).images
