"""The suite of checks, which fail where the attack is broken or the model hides its gradients: its
table, and what they say of its figures.

After Carlini et al., "On evaluating adversarial robustness" (2019), and Athalye et al., "Obfuscated
gradients give a false sense of security" (2018). Success rates are of the images that the model
gets right when clean.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pandas as pd
import torch
from torch import Tensor

from moireaug.attacks import LOSSES, evaluating
from moireaug.attacks.model import attacked_logits, repeats_answers
from moireaug.common.networks import rejects_of
from moireaug.common.numeric import widen_half
from moireaug.defenses import BitDepth
from moireaug.evaluation.attackers import MoireAttacker
from moireaug.evaluation.autoattack import QUERIES_PER_STEP, SquareAttacker
from moireaug.evaluation.classifiers import UNDEFENDED, Classifier
from moireaug.evaluation.conditions import (
    Clean,
    Condition,
    EvalBatch,
    Photo,
    RandomNoise,
    in_255ths,
)
from moireaug.evaluation.tables import Cell, SuiteConfig, Table, eps_row

LONGER_FACTOR = 2  # times as many steps
MODEL_COLUMN = "model"  # the column of the attacked model
RATE_ERROR = 0.02  # two points, or one image where that is more
ROUNDING_ERROR = 1e-9
HIDDEN_GRADIENT_SHARES = (0.3, 0.5)  # shares that warn and fail
MAX_PHOTO_SUCCESS = 0.9  # success of the photo above which no attack can add much
VERDICTS = ("fail", "warning", "pass")


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
            logits = attacked_logits(model, photo, batch.labels, rejects=rejects_of(model))
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
    rows: dict[str, Condition] = {
        "clean": CleanTwice(),
        "moire": PhotoGradient(),
        "random": RandomNoise(eps=eps),
        "one_step": MoireAttacker(eps=eps, steps=1, variant="one_step"),
        "longer": MoireAttacker(eps=eps, steps=LONGER_FACTOR * steps, variant=longer, restarts=2),
        "queries": SquareAttacker(eps=eps, steps=QUERIES_PER_STEP * steps),
    }
    through = MoireAttacker(eps=eps, steps=steps, known_classifier=rounded)
    cells = [Cell(row, MODEL_COLUMN, (condition,)) for row, condition in rows.items()]
    cells.append(Cell("shattered", MODEL_COLUMN, (through,), rounded))
    for size in growing_eps(config):
        cells.append(Cell(eps_row(size), MODEL_COLUMN, (MoireAttacker(eps=size, steps=steps),)))
    for name, model in config.targets.items():
        if model is not None:
            classifier = Classifier(name, model=model)
            untruncated = MoireAttacker(eps=eps, steps=steps, until_fooled=False)
            cells.append(Cell(eps_row(eps), name, (untruncated,), classifier))
            cells.append(Cell("random", name, (RandomNoise(eps=eps),), classifier))
    return Table("trust", tuple(cells))


@dataclass(frozen=True)
class CheckResult:
    """The result of a check: its name, the verdict "pass", "warning" or "fail", and the figures
    behind it."""

    name: str
    verdict: str
    says: str


def check_result(name: str, says: str, *, fails: bool = False, warns: bool = False) -> CheckResult:
    """Return the result of a check whose name states what it confirms."""
    verdict = "fail" if fails else "warning" if warns else "pass"
    return CheckResult(name, verdict, says)


def checks(config: SuiteConfig, images: pd.DataFrame, lines: pd.DataFrame) -> list[CheckResult]:
    """Return the result of every check, failed ones first, then warnings; a single warning if the
    model gets no image right.

    Args:
        config: scene, bounds, steps and targets of the evaluation.
        images: frame of the suite "trust", as `evaluate` returns it.
        lines: its `rates`.

    Raises:
        ValueError: a frame of another suite, or of other bounds or steps than the config's.
    """
    images = images[(images["table"] == "trust") & (images["column"] == MODEL_COLUMN)]
    lines = lines[lines["table"] == "trust"]
    model_lines = lines[lines["column"] == MODEL_COLUMN].set_index("row")
    _check_config(config, model_lines)
    clean_correct = int(model_lines.loc["clean", "counted"])
    if not clean_correct:
        says = "0 % of the images are right when clean"
        return [check_result("there is something to attack", says, warns=True)]
    results = [
        *_rate_checks(config, lines, max(RATE_ERROR, 1 / clean_correct) + ROUNDING_ERROR),
        *_answer_checks(images, model_lines),
    ]
    return sorted(results, key=lambda result: VERDICTS.index(result.verdict))


def _check_config(config: SuiteConfig, model_lines: pd.DataFrame) -> None:
    """Refuse lines that were not evaluated with this config: ValueError."""
    wanted = {eps_row(eps): config.steps for eps in growing_eps(config)}
    steps = model_lines["steps"].filter(like="eps_").to_dict()
    if steps != wanted:
        raise ValueError(
            f"the config needs rates of attacks with the steps {wanted}; got {steps}. Pass the "
            "frame of suite=trust, its rates, and a SuiteConfig of the eps and steps that it was "
            "evaluated with."
        )


def _rate_checks(config: SuiteConfig, lines: pd.DataFrame, error: float) -> list[CheckResult]:
    """Return the checks that compare success rates, each of them known up to `error`."""
    success = lines[lines["column"] == MODEL_COLUMN].set_index("row")["success"]
    percent_text = success.map(_percent)
    attack = success[eps_row(config.middle)]
    attack_text = percent_text[eps_row(config.middle)]
    random, one_step = success["random"], success["one_step"]
    growth, growth_texts = [], []
    for eps in growing_eps(config):
        growth.append(success[eps_row(eps)])
        growth_texts.append(f"{percent_text[eps_row(eps)]} at {in_255ths(eps)}/255")
    steps = config.steps
    steps_fool = "1 step fools" if steps == 1 else f"{steps} steps fool"
    return [
        check_result(
            "more steps and restarts change nothing",
            f"{steps_fool} {attack_text}, {LONGER_FACTOR * steps} steps and 2 restarts "
            f"{percent_text['longer']}",
            fails=success["longer"] - attack > error,
        ),
        check_result(
            "success grows with eps, to all images at eps 1",
            ", ".join(growth_texts),
            fails=growth[-1] < 1 or any(a - b > error for a, b in pairwise(growth)),
        ),
        _transfer_check(config, lines, attack, random, error),
        check_result(
            "many steps beat one",
            f"one {percent_text['one_step']}, {steps} {attack_text}",
            fails=one_step - attack > error,
            warns=one_step >= attack and attack < 1,
        ),
        check_result(
            "a search without gradients does not win",
            f"{QUERIES_PER_STEP * steps} queries without gradients {percent_text['queries']}, "
            f"gradients {attack_text}",
            fails=success["queries"] - attack > error,
        ),
        check_result(
            "a defence that only hides gradients is broken",
            "behind a rounding without gradient, attacked through it, "
            f"{percent_text['shattered']}; without it {attack_text}",
            fails=attack - success["shattered"] > error,
        ),
        check_result(
            "the photo leaves something to attack",
            f"the photo alone fools {percent_text['moire']}",
            warns=success["moire"] > MAX_PHOTO_SUCCESS,
        ),
    ]


def _transfer_check(
    config: SuiteConfig, lines: pd.DataFrame, attack: float, random: float, error: float
) -> CheckResult:
    """Check that the attack gains over random noise, and on other models no more than on the
    attacked one: they may be weaker, so gains are compared."""
    says = f"white box {_percent(attack)}, random noise {_percent(random)}"
    is_beyond = False
    for name in config.targets:
        rates = lines[lines["column"] == name].set_index("row")["success"]
        if len(rates) and np.isfinite(rates).all():
            theirs, chance = rates[eps_row(config.middle)], rates["random"]
            says += f"; {name} {_percent(theirs)}, random noise {_percent(chance)}"
            gain = theirs - chance
            is_beyond = is_beyond or max(-gain, gain - (attack - random)) > error
    name = "white box, then transfer, then random noise"
    return check_result(name, says, fails=random - attack > error, warns=is_beyond)


def _answer_checks(images: pd.DataFrame, model_lines: pd.DataFrame) -> list[CheckResult]:
    """Return the checks of the model's gradients and answers."""
    hidden = float(images["zero_gradients"].mean())
    warning_share, failing_share = HIDDEN_GRADIENT_SHARES
    changed = float(images["differ"].mean())
    undecided, answers = int(model_lines["undecided"].sum()), int(model_lines["n"].sum())
    return [
        check_result(
            "gradients are not hidden",
            f"{_percent(hidden)} of the photo’s values have a gradient of zero or NaN",
            fails=hidden > failing_share,
            warns=hidden > warning_share,
        ),
        check_result(
            "the model answers the same twice",
            f"asked twice, the model answers {_percent(changed)} of the images differently",
            warns=changed > 0,
        ),
        check_result(
            "every image gets an answer",
            f"the logits of {undecided} of {answers} answers are NaN or infinite, which counts as "
            "wrong",
            fails=undecided > 0,
        ),
    ]


def _percent(rate: float) -> str:
    return f"{100 * rate:.1f} %"
