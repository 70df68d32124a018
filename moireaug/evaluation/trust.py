"""Can the figures be trusted? Checks that an attack which fails to attack, or a model that hides its gradients, fails.

After Carlini et al., "On evaluating adversarial robustness" (2019), and Athalye et al., "Obfuscated gradients give a
false sense of security" (2018). Success rates are of the images that the model has right when clean.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor

from moireaug.attacks import LOSSES, evaluating
from moireaug.defenses import BitDepth
from moireaug.evaluation.adaptive import through
from moireaug.evaluation.given import Given
from moireaug.evaluation.rungs import CLEAN, MOIRE, Bout, Rung, attacking, label, moire_attack, random_noise
from moireaug.evaluation.sweep import MODEL, Index, Job, behind, gather, other

SLACK = 0.02  # two points, or one image where that is more
MASKED, SUSPECT = 0.5, 0.3  # shares of gradients that are exactly zero
LONGER = 2  # times as many steps
FULL = 0.9  # share of images fooled that leaves nothing to see
QUERIES = 5  # of the gradient-free attack, for each gradient step of the others


@dataclass(frozen=True)
class Check:
    """One check: what was asked, "pass", "warning" or "fail", and the figures that say so."""

    name: str
    verdict: str
    says: str

    def to_dict(self) -> dict[str, str]:
        return asdict(self)


def _zero_gradients(b: Bout, shown: Tensor) -> dict[str, float]:
    """Share of the photo's values whose gradient is zero or not finite; of the noise's, a camera leaves some unread."""
    with evaluating(b.model):
        photo = shown.detach().clone().requires_grad_()
        logits = b.model(photo)  # type: ignore[operator]
        if not logits.requires_grad:
            return {"zero_gradients": 1.0}
        (gradient,) = torch.autograd.grad(LOSSES["ce"](logits, b.labels).sum(), photo, allow_unused=True)
    if gradient is None:
        return {"zero_gradients": 1.0}
    hidden = (gradient == 0) | ~gradient.isfinite()
    return {"zero_gradients": hidden.float().mean().item()}


def _twice(b: Bout, shown: Tensor) -> dict[str, float]:
    """Share of images whose logits are not the same when the model is asked again."""
    with evaluating(b.model), torch.no_grad():
        first, second = (b.model(shown) for _ in range(2))  # type: ignore[operator]
    differ = (first != second) & ~(first.isnan() & second.isnan())
    return {"differ": differ.any(1).float().mean().item()}


def rungs(g: Given) -> dict[str, Rung]:
    """What the checks look at, by the names that they call it."""
    e, k = g.eps, g.steps
    shattered = moire_attack(e, k, name="through rounding")
    queries = Rung(f"square_{label(e)}", "gradient-free", attacking("square", eps=e, steps=QUERIES * k), e)
    return {
        "clean": Rung("clean_twice", "clean image, asked twice", CLEAN.show, measure=_twice),
        "moire": Rung("moire_gradient", "photo, its gradient", MOIRE.show, measure=_zero_gradients),
        "random": random_noise(e),
        "one step": moire_attack(e, 1, name="one step"),
        **{label(x): moire_attack(x, k) for x in _sizes(g)},
        "longer": moire_attack(e, LONGER * k, name=f"{LONGER * k} steps and 2 restarts", restarts=2),
        "queries": queries,
        "shattered": through(shattered, BitDepth(8)),
    }


def _sizes(g: Given) -> list[float]:
    return sorted({g.eps / 2, g.eps, min(1.0, 2 * g.eps), 1.0})


def jobs(g: Given) -> list[Job]:
    """The rungs of the checks and who judges them."""
    found, rounded = rungs(g), behind("rounded", "rounded to 8 bits", BitDepth(8))
    others = tuple(other(n, m) for n, m in g.targets.items() if m is not None)
    judged = {"shattered": (rounded,), label(g.eps): (MODEL, *others), "random": (MODEL, *others)}
    return [Job(rung, judged.get(name, (MODEL,))) for name, rung in found.items()]


class Seen(NamedTuple):
    """What the checks judge: success rates by the names of `rungs`, other models' (attacked, random), the slack, and
    how many of all answers were none: their logits were not finite."""

    rate: Mapping[str, float]
    transfer: Mapping[str, tuple[float, float]]
    zero_gradients: float
    differ: float
    slack: float
    undecided: int
    answers: int


def checks(g: Given, index: Index) -> list[Check]:
    """Every check, failed ones first, then warnings; a single warning where the model has no image right."""
    found, rounded = rungs(g), behind("rounded", "", BitDepth(8))
    rows = {name: gather(index, r, rounded if name == "shattered" else MODEL) for name, r in found.items()}
    if not any(rows["clean"].counted):
        return [Check("there is something to attack", "warning", "0 % of the images are right when clean")]
    transfer = {}
    for name, model in g.targets.items():
        if model is not None:
            judge = other(name, model)
            a, b = (gather(index, found[k], judge).to_dict()["success"] for k in (label(g.eps), "random"))
            if a is not None:
                transfer[name] = (a, b)
    seen = Seen(
        {name: row.to_dict()["success"] for name, row in rows.items()},
        transfer,
        rows["moire"].measured["zero_gradients"],
        rows["clean"].measured["differ"],
        max(SLACK, 1 / max(1, sum(rows["clean"].counted))),
        sum(sum(row.undecided) for row in rows.values()),
        sum(len(row.undecided) for row in rows.values()),
    )
    order = {"fail": 0, "warning": 1, "pass": 2}
    return sorted((check(g, seen) for check in CHECKS), key=lambda c: order[c.verdict])


def _converged(g: Given, seen: Seen) -> Check:
    now, longer = seen.rate[label(g.eps)], seen.rate["longer"]
    says = f"{g.steps} steps fool {_pc(now)}, {LONGER * g.steps} steps and 2 restarts {_pc(longer)}"
    return Check("more steps and restarts change nothing", _verdict(longer <= now + seen.slack), says)


def _grows(g: Given, seen: Seen) -> Check:
    eps = [label(x) for x in _sizes(g)]
    values = [seen.rate[e] for e in eps]
    growing = all(b >= a - seen.slack for a, b in pairwise(values))
    says = ", ".join(f"{_pc(v)} at {e}/255" for e, v in zip(eps, values, strict=True))
    return Check("success grows with eps, to all images at eps 1", _verdict(growing and values[-1] >= 1.0), says)


def _ordered(g: Given, seen: Seen) -> Check:
    name, white, random = "white box, then transfer, then random noise", seen.rate[label(g.eps)], seen.rate["random"]
    says = f"white box {_pc(white)}, random noise {_pc(random)}"
    says += "".join(f"; {n} {_pc(t)}, random noise {_pc(r)}" for n, (t, r) in seen.transfer.items())
    # another model may be weaker, so what counts is what the noise adds to chance
    odd = any(not -seen.slack <= t - r <= white - random + seen.slack for t, r in seen.transfer.values())
    return Check(name, "fail" if white < random - seen.slack else "warning" if odd else "pass", says)


def _iterates(g: Given, seen: Seen) -> Check:
    one, many = seen.rate["one step"], seen.rate[label(g.eps)]
    return Check("many steps beat one", _verdict(one <= many + seen.slack), f"one {_pc(one)}, {g.steps} {_pc(many)}")


def _gradients(g: Given, seen: Seen) -> Check:
    zero = seen.zero_gradients
    verdict = "fail" if zero > MASKED else "warning" if zero > SUSPECT else "pass"
    return Check(
        "gradients are not hidden", verdict, f"{_pc(zero)} of the photo’s values have a gradient of zero or NaN"
    )


def _queries(g: Given, seen: Seen) -> Check:
    blind, white = seen.rate["queries"], seen.rate[label(g.eps)]
    says = f"{QUERIES * g.steps} queries without gradients {_pc(blind)}, gradients {_pc(white)}"
    return Check("a search without gradients does not win", _verdict(blind <= white + seen.slack), says)


def _breaks(g: Given, seen: Seen) -> Check:
    broken, plain = seen.rate["shattered"], seen.rate[label(g.eps)]
    says = f"behind a rounding without gradient, attacked through it, {_pc(broken)}; without it {_pc(plain)}"
    name = "a defence that only hides gradients is broken"
    return Check(name, _verdict(broken >= plain - seen.slack), says)


def _settled(g: Given, seen: Seen) -> Check:
    says = f"asked twice, the model answers {_pc(seen.differ)} of the images differently"
    return Check("the model answers the same twice", "warning" if seen.differ else "pass", says)


def _answered(g: Given, seen: Seen) -> Check:
    says = f"the logits of {seen.undecided} of {seen.answers} answers are NaN or infinite, which counts as wrong"
    return Check("every image gets an answer", _verdict(seen.undecided == 0), says)


def _room(g: Given, seen: Seen) -> Check:
    """Where the photo alone fools nearly every image, no attack can show what it adds."""
    says = f"the photo alone fools {_pc(seen.rate['moire'])}"
    return Check("the photo leaves something to attack", "warning" if seen.rate["moire"] > FULL else "pass", says)


CHECKS: tuple[Callable[[Given, Seen], Check], ...] = (
    _converged, _grows, _ordered, _iterates, _gradients, _queries, _breaks, _settled, _answered, _room,
)  # fmt: skip


def _verdict(good: bool) -> str:
    return "pass" if good else "fail"


def _pc(rate: float) -> str:
    return f"{100 * rate:.1f} %"
