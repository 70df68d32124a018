"""Three of the four attackers of AutoAttack (Croce & Hein, 2020), on the raw reading: APGD-CE,
APGD-T and Square.

Its FAB-T, which looks for the least noise, is missing, and APGD starts from no noise, where theirs
starts at random. At 100 steps the budgets are AutoAttack's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from moireaug.attacks import MoireAttack, MultiTargeted, SquareMoire
from moireaug.attacks.losses import attack_margin
from moireaug.attacks.model import attacked_logits, class_count, evaluating, repeats_answers
from moireaug.attacks.result import Result
from moireaug.common.networks import rejects_of
from moireaug.common.numeric import select_rows
from moireaug.evaluation.attackers import Attacker
from moireaug.evaluation.conditions import EvalBatch

QUERIES_PER_STEP = 50  # of Square, for each step of the others: AutoAttack takes 5,000 and 100


@dataclass(frozen=True, kw_only=True)
class APGDTAttacker(Attacker):
    """APGD-T: APGD toward each of the likeliest other classes in turn, by the targeted DLR loss; a
    model of fewer than four classes has no such loss, and is attacked by the margin.

    Args:
        classes: number of target classes, the likeliest first.

    Raises:
        ValueError: a targeted one.
    """

    kind = "apgd_t"
    classes: int = 9

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.targeted:
            raise ValueError(
                f"{type(self).__name__} goes toward several classes, and succeeds with any: leave "
                'targeted out, or use MoireAttacker(rule="apgd", targeted=True).'
            )

    def attack_on(self, batch: EvalBatch) -> Callable[..., Result]:
        return MultiTargeted(self.apgd(batch, "dlr", 4), targets=self.classes)

    def apgd(self, batch: EvalBatch, loss: str, min_classes: int = 0) -> MoireAttack:
        """Return APGD by a loss or, of a model with fewer classes, by the margin."""
        if min_classes and class_count(batch.model, batch.images, batch.labels) < min_classes:
            loss = "margin"
        return self.moire_attack(batch, rule="apgd", loss=loss, until_fooled=True)


@dataclass(frozen=True, kw_only=True)
class APGDAttacker(APGDTAttacker):
    """APGD in the order of AutoAttack: by the cross-entropy, and then, on the images that are still
    right, APGD-T.

    Of a model that answers at random, being fooled once says little. As in AutoAttack's version
    "rand", all its images are attacked by the cross-entropy and by the DLR loss without a target;
    each keeps the noise whose margin is greater when the model is asked again. That version also
    averages each gradient over 20 answers; here, only a classifier that averages does so: a
    `Defended` model, or a `known_classifier`, with `draws`.
    """

    kind = "apgd"

    def perturb(self, batch: EvalBatch) -> Tensor:
        result = self.result_of(self.apgd(batch, "ce"), batch)
        if not repeats_answers(batch.model, batch.images).all():
            images = self.result_of(self.apgd(batch, "dlr", 3), batch).images
            is_better = _margins(batch, images) > _margins(batch, result.images)
            return select_rows(is_better, images, result.images)
        still_right = (~result.success).nonzero()[:, 0]
        if not len(still_right):
            return result.images
        return result.images.index_copy(0, still_right, super().perturb(batch[still_right]))


def _margins(batch: EvalBatch, images: Tensor) -> Tensor:
    """Return the margins (B,) of images shown to the batch's model."""
    with evaluating(batch.model, images), torch.no_grad():
        logits = attacked_logits(batch.model, images, batch.labels, rejects=rejects_of(batch.model))
    return attack_margin(logits, batch.labels)


class SquareAttacker(Attacker):
    """A search without gradients, on the raw reading; `steps` are queries."""

    kind = "square"

    def attack_on(self, batch: EvalBatch) -> Callable[..., Result]:
        return self.moire_attack(batch, SquareMoire, until_fooled=True)
