"""Checks of an evaluation, which fail where the attack is broken or the model hides its gradients.

After Carlini et al., "On evaluating adversarial robustness" (2019), and Athalye et al., "Obfuscated
gradients give a false sense of security" (2018). Success rates are of the images that the model
gets right when clean.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import pairwise

import numpy as np
import pandas as pd
import torch
from torch import Tensor

from moireaug.attacks import LOSSES, evaluating
from moireaug.defenses import BitDepth
from moireaug.evaluation.attackers import MoireAttacker
from moireaug.evaluation.autoattack import SquareAttacker
from moireaug.evaluation.conditions import Clean, EvalBatch, Photo, RandomNoise, codes
from moireaug.evaluation.judges import Judge
from moireaug.evaluation.tables import Cell, SuiteConfig, Table, eps_row

MAX_RATE_ERROR = 0.02  # two points, or one image where that is more
ROUNDING_ERROR = 1e-9
MASKED_SHARE, SUSPECT_SHARE = 0.5, 0.3  # share of zero gradients that fails, and that warns
LONGER_FACTOR = 2  # times as many steps
MAX_PHOTO_SUCCESS = 0.9  # above it, an attack has nothing to add to the photo
QUERIES_PER_STEP = 5  # of the gradient-free attack, for each gradient step of the others
MODEL_COLUMN = "model"  # the column of the attacked model


class CleanTwice(Clean):
    """The image, with whether the model answers it differently when asked twice."""

    kind = "clean_twice"

    def measure(self, batch: EvalBatch, images: Tensor) -> dict[str, list[float]]:
        with evaluating(batch.model, images), torch.no_grad():
            first = batch.model(images.clone())  # it may work in place
            second = batch.model(images.clone())
        differ = (first != second) & ~(first.isnan() & second.isnan())
        return {"differ": differ.any(1).float().tolist()}


class PhotoGradient(Photo):
    """The photo, with the share of its values whose gradient is zero or not finite. Gradients of
    the noise would not do, as a camera leaves some of its values unread."""

    kind = "moire_gradient"

    def measure(self, batch: EvalBatch, images: Tensor) -> dict[str, list[float]]:
        gradient = None
        with evaluating(batch.model, images), torch.enable_grad():
            photo = images.detach().clone().requires_grad_()
            logits = batch.model(photo.clone())
            if logits.requires_grad:
                loss = LOSSES["ce"](logits, batch.labels).sum()
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
    """Lay out the table that the checks judge: a row each, other models in their own columns."""
    eps, steps = config.middle, config.steps
    longer = f"{LONGER_FACTOR * steps}_steps_and_2_restarts"
    rounded = Judge("rounded", defence=BitDepth(8))
    adaptive = MoireAttacker(eps=eps, steps=steps, variant="through_rounding", knows=rounded)
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
        Cell("shattered", MODEL_COLUMN, (adaptive,), rounded),
    ]
    for size in growing_eps(config):
        cells.append(Cell(eps_row(size), MODEL_COLUMN, (MoireAttacker(eps=size, steps=steps),)))
    for name, model in config.targets.items():
        if model is not None:
            judge = Judge(name, model=model)
            untruncated = MoireAttacker(eps=eps, steps=steps, until_fooled=False)
            cells.append(Cell(eps_row(eps), name, (untruncated,), judge))
            cells.append(Cell("random", name, (RandomNoise(eps=eps),), judge))
    return Table("trust", tuple(cells))


@dataclass(frozen=True)
class Check:
    """One check: its name, the verdict "pass", "warning" or "fail", and the figures behind it."""

    name: str
    verdict: str
    says: str

    def to_dict(self) -> dict[str, str]:
        return asdict(self)


@dataclass(frozen=True)
class CheckInputs:
    """The figures that the checks judge.

    Args:
        config: config of the suite.
        success: success rates of the attacked model by row.
        transfer: success rates (attacked, random) of other models by name.
        zero_gradients: share of gradients that are zero or not finite.
        differ: share of images answered differently when asked twice.
        slack: allowed error of a rate.
        undecided: number of answers whose logits were not finite.
        answers: number of answers.
    """

    config: SuiteConfig
    success: dict[str, float]
    transfer: dict[str, tuple[float, float]]
    zero_gradients: float
    differ: float
    slack: float
    undecided: int
    answers: int

    @property
    def attack(self) -> float:
        """Success rate of the attack that the suites compare."""
        return self.success[eps_row(self.config.middle)]


def checks(config: SuiteConfig, images: pd.DataFrame, lines: pd.DataFrame) -> list[Check]:
    """Return every check, failed ones first, then warnings; a single warning if the model gets no
    image right.

    Args:
        config: config of the suite.
        images: frame with a row per cell and image, see `images_frame`.
        lines: its rates, see `rates`.
    """
    images = images[images["table"] == "trust"]
    lines = lines[lines["table"] == "trust"]
    model_lines = lines[lines["column"] == MODEL_COLUMN].set_index("row")
    clean_correct = int(model_lines.loc["clean", "counted"])
    if not clean_correct:
        summary = "0 % of the images are right when clean"
        return [Check("there is something to attack", "warning", summary)]
    transfer = {}
    for name in config.targets:
        success = lines[lines["column"] == name].set_index("row")["success"]
        if len(success) and np.isfinite(success).all():
            transfer[name] = (success[eps_row(config.middle)], success["random"])
    model_images = images[images["column"] == MODEL_COLUMN]
    inputs = CheckInputs(
        config,
        model_lines["success"].to_dict(),
        transfer,
        float(model_images["zero_gradients"].mean()),
        float(model_images["differ"].mean()),
        max(MAX_RATE_ERROR, 1 / clean_correct) + ROUNDING_ERROR,
        int(model_lines["undecided"].sum()),
        int(model_lines["n"].sum()),
    )
    order = {"fail": 0, "warning": 1, "pass": 2}
    return sorted((check(inputs) for check in CHECKS), key=lambda check: order[check.verdict])


def _check_convergence(inputs: CheckInputs) -> Check:
    now, longer, steps = inputs.attack, inputs.success["longer"], inputs.config.steps
    fool = "1 step fools" if steps == 1 else f"{steps} steps fool"
    summary = (
        f"{fool} {_percent(now)}, {LONGER_FACTOR * steps} steps and 2 restarts {_percent(longer)}"
    )
    verdict = _verdict(longer <= now + inputs.slack)
    return Check("more steps and restarts change nothing", verdict, summary)


def _check_growth(inputs: CheckInputs) -> Check:
    eps = growing_eps(inputs.config)
    values = [inputs.success[eps_row(e)] for e in eps]
    growing = all(b >= a - inputs.slack for a, b in pairwise(values))
    summary = ", ".join(
        f"{_percent(v)} at {codes(e)}/255" for e, v in zip(eps, values, strict=True)
    )
    verdict = _verdict(growing and values[-1] >= 1.0)
    return Check("success grows with eps, to all images at eps 1", verdict, summary)


def _check_order(inputs: CheckInputs) -> Check:
    white, random = inputs.attack, inputs.success["random"]
    summary = f"white box {_percent(white)}, random noise {_percent(random)}"
    verdict = "pass"
    for name, (attacked, chance) in inputs.transfer.items():
        summary += f"; {name} {_percent(attacked)}, random noise {_percent(chance)}"
        # another model may be weaker: compare the gains over chance
        if not -inputs.slack <= attacked - chance <= white - random + inputs.slack:
            verdict = "warning"
    if white < random - inputs.slack:
        verdict = "fail"
    return Check("white box, then transfer, then random noise", verdict, summary)


def _check_iteration(inputs: CheckInputs) -> Check:
    one, many = inputs.success["one_step"], inputs.attack
    summary = f"one {_percent(one)}, {inputs.config.steps} {_percent(many)}"
    return Check("many steps beat one", _verdict(one <= many + inputs.slack), summary)


def _check_gradients(inputs: CheckInputs) -> Check:
    zero = inputs.zero_gradients
    verdict = "pass"
    if zero > SUSPECT_SHARE:
        verdict = "warning"
    if zero > MASKED_SHARE:
        verdict = "fail"
    summary = f"{_percent(zero)} of the photo’s values have a gradient of zero or NaN"
    return Check("gradients are not hidden", verdict, summary)


def _check_queries(inputs: CheckInputs) -> Check:
    blind, white = inputs.success["queries"], inputs.attack
    queries = QUERIES_PER_STEP * inputs.config.steps
    summary = f"{queries} queries without gradients {_percent(blind)}, gradients {_percent(white)}"
    verdict = _verdict(blind <= white + inputs.slack)
    return Check("a search without gradients does not win", verdict, summary)


def _check_shattered(inputs: CheckInputs) -> Check:
    broken, plain = inputs.success["shattered"], inputs.attack
    summary = f"behind a rounding without gradient, attacked through it, {_percent(broken)}; "
    summary += f"without it {_percent(plain)}"
    verdict = _verdict(broken >= plain - inputs.slack)
    return Check("a defence that only hides gradients is broken", verdict, summary)


def _check_determinism(inputs: CheckInputs) -> Check:
    summary = f"asked twice, the model answers {_percent(inputs.differ)} of the images differently"
    return Check(
        "the model answers the same twice", "warning" if inputs.differ else "pass", summary
    )


def _check_answers(inputs: CheckInputs) -> Check:
    summary = f"the logits of {inputs.undecided} of {inputs.answers} answers are NaN or infinite, "
    summary += "which counts as wrong"
    return Check("every image gets an answer", _verdict(inputs.undecided == 0), summary)


def _check_photo(inputs: CheckInputs) -> Check:
    """Warn where the photo alone fools nearly every image, so that no attack can add to it."""
    photo = inputs.success["moire"]
    verdict = "warning" if photo > MAX_PHOTO_SUCCESS else "pass"
    summary = f"the photo alone fools {_percent(photo)}"
    return Check("the photo leaves something to attack", verdict, summary)


CHECKS: tuple[Callable[[CheckInputs], Check], ...] = (
    _check_convergence,
    _check_growth,
    _check_order,
    _check_iteration,
    _check_gradients,
    _check_queries,
    _check_shattered,
    _check_determinism,
    _check_answers,
    _check_photo,
)


def _verdict(good: bool) -> str:
    return "pass" if good else "fail"


def _percent(rate: float) -> str:
    return f"{100 * rate:.1f} %"
