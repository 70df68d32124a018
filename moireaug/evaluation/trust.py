"""Can the figures be trusted? Checks that fail where the attack is broken, or the model hides its
gradients.

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

SLACK = 0.02  # two points, or one image where that is more
ROUNDING = 1e-9
MASKED, SUSPECT = 0.5, 0.3  # shares of gradients that are exactly zero
LONGER = 2  # times as many steps
FULL = 0.9  # share of images fooled by the photo above which an attack can add nothing
QUERIES = 5  # of the gradient-free attack, for each gradient step of the others
MODEL = "model"  # the column of the attacked model


class CleanTwice(Clean):
    """The image, with whether the model answers it differently when asked twice."""

    kind = "clean_twice"

    def measure(self, batch: EvalBatch, shown: Tensor) -> dict[str, list[float]]:
        with evaluating(batch.model, shown), torch.no_grad():
            first = batch.model(shown.clone())  # it may work in place
            second = batch.model(shown.clone())
        differ = (first != second) & ~(first.isnan() & second.isnan())
        return {"differ": differ.any(1).float().tolist()}


class PhotoGradient(Photo):
    """The photo, with the share of its values whose gradient is zero or not finite. Gradients of
    the noise would not do, as a camera leaves some of its values unread."""

    kind = "moire_gradient"

    def measure(self, batch: EvalBatch, shown: Tensor) -> dict[str, list[float]]:
        gradient = None
        with evaluating(batch.model, shown), torch.enable_grad():
            photo = shown.detach().clone().requires_grad_()
            logits = batch.model(photo.clone())
            if logits.requires_grad:
                loss = LOSSES["ce"](logits, batch.labels).sum()
                (gradient,) = torch.autograd.grad(loss, photo, allow_unused=True)
        if gradient is None:
            return {"zero_gradients": [1.0] * len(shown)}
        hidden = (gradient == 0) | ~gradient.isfinite()
        return {"zero_gradients": hidden.float().mean((1, 2, 3)).tolist()}


def sizes(config: SuiteConfig) -> list[float]:
    """Return the bounds that success must grow with."""
    eps = config.middle
    return sorted({eps / 2, eps, min(1.0, 2 * eps), 1.0})


def trust(config: SuiteConfig) -> Table:
    """Lay out what the checks look at: a row each, other models in their own columns."""
    eps, steps = config.middle, config.steps
    longer = f"{LONGER * steps}_steps_and_2_restarts"
    rounded = Judge("rounded", defence=BitDepth(8))
    through = MoireAttacker(eps=eps, steps=steps, variant="through_rounding", knows=rounded)
    cells = [
        Cell("clean", MODEL, (CleanTwice(),)),
        Cell("moire", MODEL, (PhotoGradient(),)),
        Cell("random", MODEL, (RandomNoise(eps=eps),)),
        Cell("one_step", MODEL, (MoireAttacker(eps=eps, steps=1, variant="one_step"),)),
        Cell(
            "longer",
            MODEL,
            (MoireAttacker(eps=eps, steps=LONGER * steps, variant=longer, restarts=2),),
        ),
        Cell("queries", MODEL, (SquareAttacker(eps=eps, steps=QUERIES * steps),)),
        Cell("shattered", MODEL, (through,), rounded),
    ]
    for size in sizes(config):
        cells.append(Cell(eps_row(size), MODEL, (MoireAttacker(eps=size, steps=steps),)))
    for name, model in config.targets.items():
        if model is not None:
            judge = Judge(name, model=model)
            whole = MoireAttacker(eps=eps, steps=steps, until_fooled=False)
            cells.append(Cell(eps_row(eps), name, (whole,), judge))
            cells.append(Cell("random", name, (RandomNoise(eps=eps),), judge))
    return Table("trust", tuple(cells))


@dataclass(frozen=True)
class Check:
    """One check: what was asked, the verdict "pass", "warning" or "fail", and the figures behind
    it."""

    name: str
    verdict: str
    says: str

    def to_dict(self) -> dict[str, str]:
        return asdict(self)


@dataclass(frozen=True)
class Seen:
    """What the checks judge.

    Args:
        config: of the suite.
        success: rates of the attacked model by row. transfer: other models' (attacked, random) by
            name.
        zero_gradients: share of gradients that are hidden. differ: share of images answered
            differently when asked twice.
        slack: by how much a rate may be off. undecided: how many of `answers` had logits that were
            not finite.
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
        """Success of the attack that the suites compare."""
        return self.success[eps_row(self.config.middle)]


def checks(config: SuiteConfig, images: pd.DataFrame, lines: pd.DataFrame) -> list[Check]:
    """Return every check, failed ones first, then warnings; a single warning if the model gets no
    image right.

    Args:
        config: of the suite. images, lines: the frame of the table `trust`, and its rates.
    """
    images = images[images["table"] == "trust"]
    lines = lines[lines["table"] == "trust"]
    own = lines[lines["column"] == MODEL].set_index("row")
    counted = int(own.loc["clean", "counted"])
    if not counted:
        says = "0 % of the images are right when clean"
        return [Check("there is something to attack", "warning", says)]
    transfer = {}
    for name in config.targets:
        other = lines[lines["column"] == name].set_index("row")["success"]
        if len(other) and np.isfinite(other).all():
            transfer[name] = (other[eps_row(config.middle)], other["random"])
    own_images = images[images["column"] == MODEL]
    seen = Seen(
        config,
        own["success"].to_dict(),
        transfer,
        float(own_images["zero_gradients"].mean()),
        float(own_images["differ"].mean()),
        max(SLACK, 1 / counted) + ROUNDING,
        int(own["undecided"].sum()),
        int(own["n"].sum()),
    )
    order = {"fail": 0, "warning": 1, "pass": 2}
    return sorted((check(seen) for check in CHECKS), key=lambda check: order[check.verdict])


def _converged(seen: Seen) -> Check:
    now, longer, steps = seen.attack, seen.success["longer"], seen.config.steps
    fool = "1 step fools" if steps == 1 else f"{steps} steps fool"
    says = f"{fool} {_pc(now)}, {LONGER * steps} steps and 2 restarts {_pc(longer)}"
    verdict = _verdict(longer <= now + seen.slack)
    return Check("more steps and restarts change nothing", verdict, says)


def _grows(seen: Seen) -> Check:
    eps = sizes(seen.config)
    values = [seen.success[eps_row(e)] for e in eps]
    growing = all(b >= a - seen.slack for a, b in pairwise(values))
    says = ", ".join(f"{_pc(v)} at {codes(e)}/255" for e, v in zip(eps, values, strict=True))
    verdict = _verdict(growing and values[-1] >= 1.0)
    return Check("success grows with eps, to all images at eps 1", verdict, says)


def _ordered(seen: Seen) -> Check:
    white, random = seen.attack, seen.success["random"]
    says = f"white box {_pc(white)}, random noise {_pc(random)}"
    verdict = "pass"
    for name, (attacked, chance) in seen.transfer.items():
        says += f"; {name} {_pc(attacked)}, random noise {_pc(chance)}"
        # another model may be weaker, so what counts is what the noise adds to chance
        if not -seen.slack <= attacked - chance <= white - random + seen.slack:
            verdict = "warning"
    if white < random - seen.slack:
        verdict = "fail"
    return Check("white box, then transfer, then random noise", verdict, says)


def _iterates(seen: Seen) -> Check:
    one, many = seen.success["one_step"], seen.attack
    says = f"one {_pc(one)}, {seen.config.steps} {_pc(many)}"
    return Check("many steps beat one", _verdict(one <= many + seen.slack), says)


def _gradients(seen: Seen) -> Check:
    zero = seen.zero_gradients
    verdict = "pass"
    if zero > SUSPECT:
        verdict = "warning"
    if zero > MASKED:
        verdict = "fail"
    says = f"{_pc(zero)} of the photo’s values have a gradient of zero or NaN"
    return Check("gradients are not hidden", verdict, says)


def _queries(seen: Seen) -> Check:
    blind, white = seen.success["queries"], seen.attack
    queries = QUERIES * seen.config.steps
    says = f"{queries} queries without gradients {_pc(blind)}, gradients {_pc(white)}"
    verdict = _verdict(blind <= white + seen.slack)
    return Check("a search without gradients does not win", verdict, says)


def _breaks(seen: Seen) -> Check:
    broken, plain = seen.success["shattered"], seen.attack
    says = f"behind a rounding without gradient, attacked through it, {_pc(broken)}; "
    says += f"without it {_pc(plain)}"
    verdict = _verdict(broken >= plain - seen.slack)
    return Check("a defence that only hides gradients is broken", verdict, says)


def _settled(seen: Seen) -> Check:
    says = f"asked twice, the model answers {_pc(seen.differ)} of the images differently"
    return Check("the model answers the same twice", "warning" if seen.differ else "pass", says)


def _answered(seen: Seen) -> Check:
    says = f"the logits of {seen.undecided} of {seen.answers} answers are NaN or infinite, "
    says += "which counts as wrong"
    return Check("every image gets an answer", _verdict(seen.undecided == 0), says)


def _room(seen: Seen) -> Check:
    """Where the photo alone fools nearly every image, no attack can show what it adds."""
    photo = seen.success["moire"]
    verdict = "warning" if photo > FULL else "pass"
    return Check(
        "the photo leaves something to attack", verdict, f"the photo alone fools {_pc(photo)}"
    )


CHECKS: tuple[Callable[[Seen], Check], ...] = (
    _converged,
    _grows,
    _ordered,
    _iterates,
    _gradients,
    _queries,
    _breaks,
    _settled,
    _answered,
    _room,
)


def _verdict(good: bool) -> str:
    return "pass" if good else "fail"


def _pc(rate: float) -> str:
    return f"{100 * rate:.1f} %"
