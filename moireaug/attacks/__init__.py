"""Attacks: one loop, and the noise, pixels or pose that it moves. Models take images in [0, 1] and
return logits."""

from typing import NoReturn

from moireaug.attacks.base import ATTACK_ADVICE, ModelAttack
from moireaug.attacks.bounds import BOUNDS
from moireaug.attacks.checks import NoAnswerError
from moireaug.attacks.cw import CW
from moireaug.attacks.loop import Attack
from moireaug.attacks.losses import LOSSES, REJECTED, UNDECIDED, margin, predicted
from moireaug.attacks.model import Normalized, evaluating
from moireaug.attacks.moire import MoireAttack
from moireaug.attacks.multitargeted import MultiTargeted
from moireaug.attacks.photographed import Photographed
from moireaug.attacks.pixel import BIM, MIFGSM, PGD, Patch
from moireaug.attacks.result import Result
from moireaug.attacks.rules import RULES
from moireaug.attacks.square import SquareMoire

ATTACKS: dict[str, type[ModelAttack]] = {
    "ma": MoireAttack,
    "pgd": PGD,
    "bim": BIM,
    "mifgsm": MIFGSM,
    "cw": CW,
    "patch": Patch,
    "square": SquareMoire,
}

__all__ = [
    "ATTACKS",
    "BIM",
    "BOUNDS",
    "CW",
    "LOSSES",
    "MIFGSM",
    "PGD",
    "REJECTED",
    "RULES",
    "UNDECIDED",
    "Attack",
    "MoireAttack",
    "MultiTargeted",
    "NoAnswerError",
    "Normalized",
    "Patch",
    "Photographed",
    "Result",
    "SquareMoire",
    "evaluating",
    "margin",
    "predicted",
]


def __getattr__(name: str) -> NoReturn:
    advice = f": {ATTACK_ADVICE[name]}" if name in ATTACK_ADVICE else ""
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}{advice}.")
