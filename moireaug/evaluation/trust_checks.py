"""The checks of an evaluation, which fail where the attack is broken or the model hides its
gradients; the table that they judge is laid out in `trust.py`.

After Carlini et al., "On evaluating adversarial robustness" (2019), and Athalye et al., "Obfuscated
gradients give a false sense of security" (2018). Success rates are of the images that the model
gets right when clean.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import pairwise

import numpy as np
import pandas as pd

from moireaug.evaluation.autoattack import QUERIES_PER_STEP
from moireaug.evaluation.conditions import codes
from moireaug.evaluation.tables import SuiteConfig, eps_row
from moireaug.evaluation.trust import LONGER_FACTOR, MODEL_COLUMN, growing_eps

RATE_ERROR = 0.02  # two points, or one image where that is more
ROUNDING_ERROR = 1e-9


@dataclass(frozen=True)
class CheckResult:
    """The result of a check: its name, the verdict "pass", "warning" or "fail", and the figures
    behind it."""

    name: str
    verdict: str
    says: str

    def to_dict(self) -> dict[str, str]:
        return asdict(self)


@dataclass(frozen=True)
class CheckInputs:
    """The figures that the checks judge.

    Args:
        steps: gradient steps of the attack.
        success: success rates of the attacked model by row; "attack" is that of the attack that the
            suites compare.
        growth: success rates by eps, from the smallest on.
        transfer: success rates (attacked, random) of other models by name.
        zero_gradient_share: share of gradients that are zero or not finite.
        changed_share: share of images answered differently when asked twice.
        undecided: number of answers whose logits were not finite.
        answers: number of answers.
        rate_error: allowed error of a rate.
    """

    steps: int
    success: dict[str, float]
    growth: dict[float, float]
    transfer: dict[str, tuple[float, float]]
    zero_gradient_share: float
    changed_share: float
    undecided: int
    answers: int
    rate_error: float

    def texts(self) -> dict[str, object]:
        """Return the figures by name, as the checks print them."""
        texts: dict[str, object] = {row: _percent(rate) for row, rate in self.success.items()}
        growth = [f"{_percent(rate)} at {codes(eps)}/255" for eps, rate in self.growth.items()]
        transfer = ""
        for name, (attacked, chance) in self.transfer.items():
            transfer += f"; {name} {_percent(attacked)}, random noise {_percent(chance)}"
        return texts | {
            "steps": self.steps,
            "steps_fool": "1 step fools" if self.steps == 1 else f"{self.steps} steps fool",
            "longer_steps": LONGER_FACTOR * self.steps,
            "query_count": QUERIES_PER_STEP * self.steps,
            "growth": ", ".join(growth),
            "transfer": transfer,
            "zero_gradient_share": _percent(self.zero_gradient_share),
            "changed_share": _percent(self.changed_share),
            "undecided": self.undecided,
            "answers": self.answers,
        }


@dataclass(frozen=True)
class Limit:
    """A figure, and the threshold that it must not exceed; None is the error of a rate."""

    figure: Callable[[CheckInputs], float]
    threshold: float | None = None

    def is_exceeded(self, inputs: CheckInputs) -> bool:
        threshold = inputs.rate_error if self.threshold is None else self.threshold
        return self.figure(inputs) > threshold


def excess(row: str, over: str) -> Limit:
    """Limit by how much the success in a row exceeds that in another."""
    return Limit(lambda inputs: inputs.success[row] - inputs.success[over])


def decline(inputs: CheckInputs) -> float:
    """Return the largest decline of success from one eps to the next; infinity where an image
    withstands the largest."""
    rates = list(inputs.growth.values())
    if rates[-1] < 1.0:
        return math.inf
    return max((before - after for before, after in pairwise(rates)), default=0.0)


def unbeaten(inputs: CheckInputs) -> float:
    """Return by how much the success of one step exceeds that of many; minus infinity where many
    fool all images."""
    many = inputs.success["attack"]
    return -math.inf if many == 1.0 else inputs.success["one_step"] - many


def transfer_error(inputs: CheckInputs) -> float:
    """Return by how much the attack's gain over random noise on another model lies outside of [0,
    its gain on the attacked one]: another model may be weaker, so gains are compared."""
    white_gain = inputs.success["attack"] - inputs.success["random"]
    gains = [attacked - chance for attacked, chance in inputs.transfer.values()]
    return max((max(-gain, gain - white_gain) for gain in gains), default=0.0)


@dataclass(frozen=True)
class Check:
    """One check.

    Args:
        name: statement that is checked.
        summary: figures behind the verdict, as a format of `CheckInputs.texts`.
        fails, warns: limits above which the check fails, or warns.
    """

    name: str
    summary: str
    fails: Limit | None = None
    warns: Limit | None = None

    def result(self, inputs: CheckInputs) -> CheckResult:
        verdict = "pass"
        if self.warns is not None and self.warns.is_exceeded(inputs):
            verdict = "warning"
        if self.fails is not None and self.fails.is_exceeded(inputs):
            verdict = "fail"
        return CheckResult(self.name, verdict, self.summary.format(**inputs.texts()))


CHECKS = (
    Check(
        "more steps and restarts change nothing",
        "{steps_fool} {attack}, {longer_steps} steps and 2 restarts {longer}",
        fails=excess("longer", over="attack"),
    ),
    Check(
        "success grows with eps, to all images at eps 1",
        "{growth}",
        fails=Limit(decline),
    ),
    Check(
        "white box, then transfer, then random noise",
        "white box {attack}, random noise {random}{transfer}",
        fails=excess("random", over="attack"),
        warns=Limit(transfer_error),
    ),
    Check(
        "many steps beat one",
        "one {one_step}, {steps} {attack}",
        fails=excess("one_step", over="attack"),
        warns=Limit(unbeaten, -ROUNDING_ERROR),  # a tie, too
    ),
    Check(
        "gradients are not hidden",
        "{zero_gradient_share} of the photo’s values have a gradient of zero or NaN",
        fails=Limit(lambda inputs: inputs.zero_gradient_share, 0.5),
        warns=Limit(lambda inputs: inputs.zero_gradient_share, 0.3),
    ),
    Check(
        "a search without gradients does not win",
        "{query_count} queries without gradients {queries}, gradients {attack}",
        fails=excess("queries", over="attack"),
    ),
    Check(
        "a defence that only hides gradients is broken",
        "behind a rounding without gradient, attacked through it, {shattered}; without it {attack}",
        fails=excess("attack", over="shattered"),
    ),
    Check(
        "the model answers the same twice",
        "asked twice, the model answers {changed_share} of the images differently",
        warns=Limit(lambda inputs: inputs.changed_share, 0.0),
    ),
    Check(
        "every image gets an answer",
        "the logits of {undecided} of {answers} answers are NaN or infinite, which counts as wrong",
        fails=Limit(lambda inputs: inputs.undecided, 0.0),
    ),
    Check(
        "the photo leaves something to attack",  # above the threshold, no attack can add much
        "the photo alone fools {moire}",
        warns=Limit(lambda inputs: inputs.success["moire"], 0.9),
    ),
)


def checks(config: SuiteConfig, images: pd.DataFrame, lines: pd.DataFrame) -> list[CheckResult]:
    """Return the result of every check, failed ones first, then warnings; a single warning if the
    model gets no image right.

    Args:
        config: config of the suite.
        images: frame with a row per cell and image, see `images_frame`.
        lines: its rates, see `rates`.
    """
    images = images[(images["table"] == "trust") & (images["column"] == MODEL_COLUMN)]
    lines = lines[lines["table"] == "trust"]
    model_lines = lines[lines["column"] == MODEL_COLUMN].set_index("row")
    clean_correct = int(model_lines.loc["clean", "counted"])
    if not clean_correct:
        summary = "0 % of the images are right when clean"
        return [CheckResult("there is something to attack", "warning", summary)]
    attack_row = eps_row(config.middle)
    success = model_lines["success"].to_dict()
    transfer = {}
    for name in config.targets:
        rates = lines[lines["column"] == name].set_index("row")["success"]
        if len(rates) and np.isfinite(rates).all():
            transfer[name] = (rates[attack_row], rates["random"])
    inputs = CheckInputs(
        steps=config.steps,
        success=success | {"attack": success[attack_row]},
        growth={eps: success[eps_row(eps)] for eps in growing_eps(config)},
        transfer=transfer,
        zero_gradient_share=float(images["zero_gradients"].mean()),
        changed_share=float(images["differ"].mean()),
        undecided=int(model_lines["undecided"].sum()),
        answers=int(model_lines["n"].sum()),
        rate_error=max(RATE_ERROR, 1 / clean_correct) + ROUNDING_ERROR,
    )
    order = {"fail": 0, "warning": 1, "pass": 2}
    return sorted((check.result(inputs) for check in CHECKS), key=lambda one: order[one.verdict])


def _percent(rate: float) -> str:
    return f"{100 * rate:.1f} %"
