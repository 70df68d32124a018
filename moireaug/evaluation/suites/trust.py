"""The table that the checks of an evaluation read: see `trust_checks.py`."""

from __future__ import annotations

import torch
from torch import Tensor

from moireaug.attacks import LOSSES, evaluating
from moireaug.attacks.model import attacked_logits, repeats_answers
from moireaug.common.numeric import widen_half
from moireaug.defenses import BitDepth
from moireaug.evaluation.attackers import MoireAttacker
from moireaug.evaluation.autoattack import QUERIES_PER_STEP, SquareAttacker
from moireaug.evaluation.classifiers import UNDEFENDED, Classifier
from moireaug.evaluation.conditions import Clean, EvalBatch, Photo, RandomNoise
from moireaug.evaluation.tables import Cell, SuiteConfig, Table, eps_row

LONGER_FACTOR = 2  # times as many steps
MODEL_COLUMN = "model"  # the column of the attacked model


class CleanTwice(Clean):
    """The image, with whether the model answers it differently when asked twice."""

    kind = "clean_twice"

    def measure(self, batch: EvalBatch, images: Tensor) -> dict[str, list[float]]:
        differ = ~repeats_answers(UNDEFENDED.defended(batch.model, batch.max_images), images)
        return {"differ": differ.float().tolist()}


class PhotoGradient(Photo):
    """The photo, with the share of its values whose gradient of the attack's loss is zero or not
    finite. Gradients of the noise would not do, as a camera leaves some of its values unread."""

    kind = "moire_gradient"

    def measure(self, batch: EvalBatch, images: Tensor) -> dict[str, list[float]]:
        gradient = None
        model = UNDEFENDED.defended(batch.model, batch.max_images)
        with evaluating(model, images), torch.enable_grad():
            photo = images.detach().clone().requires_grad_()
            logits = attacked_logits(model, photo, batch.labels)
            if logits.requires_grad:
                loss = LOSSES["ce"](widen_half(logits), batch.labels).sum()
                (gradient,) = torch.autograd.grad(loss, photo, allow_unused=True)
        if gradient is None:
            return {"zero_gradients": [1.0] * len(images)}
        hidden = (gradient == 0) | ~gradient.isfinite()
        return {"zero_gradients": hidden.float().mean((1, 2, 3)).tolist()}


def growing_eps(config: SuiteConfig) -> list[float]:
    """Return bounds in ascending order, with which success must grow."""
    eps = config.middle
    return sorted({eps / 2, eps, min(1.0, 2 * eps), 1.0})


def trust(config: SuiteConfig) -> Table:
    """Lay out the table that the checks read: a row each, other models in their own columns."""
    eps, steps = config.middle, config.steps
    longer = f"{LONGER_FACTOR * steps}_steps_and_2_restarts"
    rounded = Classifier("rounded", defence=BitDepth(8))
    through = MoireAttacker(eps=eps, steps=steps, known_classifier=rounded)
    cells = [
        Cell("clean", MODEL_COLUMN, (CleanTwice(),)),
        Cell("moire", MODEL_COLUMN, (PhotoGradient(),)),
        Cell("random", MODEL_COLUMN, (RandomNoise(eps=eps),)),
        Cell("one_step", MODEL_COLUMN, (MoireAttacker(eps=eps, steps=1, variant="one_step"),)),
        Cell(
            "longer",
            MODEL_COLUMN,
            (MoireAttacker(eps=eps, steps=LONGER_FACTOR * steps, variant=longer, restarts=2),),
        ),
        Cell("queries", MODEL_COLUMN, (SquareAttacker(eps=eps, steps=QUERIES_PER_STEP * steps),)),
        Cell("shattered", MODEL_COLUMN, (through,), rounded),
    ]
    for size in growing_eps(config):
        cells.append(Cell(eps_row(size), MODEL_COLUMN, (MoireAttacker(eps=size, steps=steps),)))
    for name, model in config.targets.items():
        if model is not None:
            classifier = Classifier(name, model=model)
            untruncated = MoireAttacker(eps=eps, steps=steps, until_fooled=False)
            cells.append(Cell(eps_row(eps), name, (untruncated,), classifier))
            cells.append(Cell("random", name, (RandomNoise(eps=eps),), classifier))
    return Table("trust", tuple(cells))
