"""Attacks: one loop, and the noise, pixels or pose that it moves. Models take images in [0, 1] and return logits."""

from moireaug.attacks.loop import Attack, Result
from moireaug.attacks.losses import LOSSES, margin
from moireaug.attacks.model import Normalized, evaluating
from moireaug.attacks.moire import MoireAttack
from moireaug.attacks.pixel import PGD

__all__ = ["LOSSES", "PGD", "Attack", "MoireAttack", "Normalized", "Result", "evaluating", "margin"]
