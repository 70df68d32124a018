"""Names of other attack libraries, such as torchattacks and ART, and what stands for them here."""

from __future__ import annotations

from typing import Any, Self

ATTACK_ADVICE = {
    "FGSM": "attacks.BIM(model, steps=1) is FGSM",
    "APGD": 'pass rule="apgd", as in attacks.PGD(model, rule="apgd", steps=100)',
    "APGDT": 'take attacks.MultiTargeted(attacks.PGD(model, rule="apgd", loss="dlr", steps=100))',
    "AutoAttack": (
        'evaluation.evaluate(model, loader, suite="standard") attacks by three of its four '
        "attackers, and attacks.Photographed puts a camera in front of a model for the original"
    ),
    "Square": "attacks.SquareMoire searches without gradients",
    "PGDL2": "noise is bounded in L-infinity; attacks.CW minimises the L2 distance",
}
STEPS_ADVICE = "pass steps="
EPS_ADVICE = "pass eps=, in [0, 1] units"
ARGUMENT_ADVICE = {
    "alpha": "pass step_size=, in units of eps: alpha / eps",
    "eps_step": "pass step_size=, in units of eps: eps_step / eps",
    "targeted": "pass targets to the call: attack(images, labels, targets)",
    "epsilon": EPS_ADVICE,
    "max_iter": STEPS_ADVICE,
    "iterations": STEPS_ADVICE,
    "n_queries": STEPS_ADVICE,
    "kappa": "pass confidence= to attacks.CW",
    "decay": "the momentum's decay is 1 here, as published: leave it out",
    "norm": "noise is bounded in L-infinity; attacks.CW minimises the L2 distance",
}


class NamesForeignArguments:
    """Base of attacks: an argument of other libraries is refused with the one that stands for it.

    Raises:
        TypeError: such an argument.
    """

    def __new__(cls, *_: Any, **settings: Any) -> Self:
        for name in settings:
            if name in ARGUMENT_ADVICE and name not in getattr(cls, "__dataclass_fields__", {}):
                raise TypeError(
                    f"{cls.__name__} has no argument {name!r}: {ARGUMENT_ADVICE[name]}."
                )
        return super().__new__(cls)
