"""What attackers do who know of a defence, or do not know of the pose."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import torch
from torch import Tensor

from moireaug.attacks import MoireAttack
from moireaug.attacks.pose import moved_fields
from moireaug.capture import capture
from moireaug.defenses import Defended
from moireaug.evaluation.rungs import Bout, Rung, label, moire_attack, unless_broken
from moireaug.scene.scene import Scene

DRAWS = 4  # of an expectation, of shots or of a randomised defence
Defence = Callable[[Tensor], Tensor]


def through(rung: Rung, defence: Defence) -> Rung:
    """The same attack on the model behind a defence: backward by the defence's own approximation (BPDA), and by
    expectation over its draws where it is randomised (EOT)."""
    n = DRAWS if getattr(defence, "randomised", False) else 1

    def show(b: Bout) -> Tensor:
        return rung.show(dataclasses.replace(b, model=Defended(b.model, defence, draws=n)))

    return dataclasses.replace(rung, show=_in_turn(show, n))


def _in_turn(show: Callable[[Bout], Tensor], n: int) -> Callable[[Bout], Tensor]:
    """A batch in n parts: an expectation over n draws holds n times the images, and so no more than a batch."""

    def parts(b: Bout) -> Tensor:
        size = -(-len(b.images) // n)
        return torch.cat([show(b[i : i + size]) for i in range(0, len(b.images), size)])

    return parts


def strong(eps: float, steps: int, name: str = "margin, halving, 2 restarts") -> Rung:
    """The Moiré Attack that searches harder: by the margin, with halved steps (as APGD's) and two restarts."""
    return moire_attack(eps, steps, name=name, rule="apgd", loss="margin", restarts=2)


def blind(eps: float, steps: int) -> Rung:
    """Noise that was found by expectation over other shots, on the shot that is judged."""

    def show(b: Bout) -> Tensor:
        attack = MoireAttack(model=b.model, scene=b.shot.scene, eps=eps, steps=steps, eot=DRAWS)
        return unless_broken(
            lambda: capture(b.images, b.shot, attack(b.images, b.labels, generator=b.generator).noise),
            lambda: capture(b.images, b.shot),
        )

    return Rung(f"blind_{label(eps)}", "Moiré Attack at another pose", _in_turn(show, DRAWS), eps)


def turnable(scene: Scene) -> tuple[tuple[str, ...], str]:
    """Which of view and panel an attacker can turn, and, where it is none, why."""
    found, why = [], ""
    for part in ("view", "panel"):
        try:
            moved_fields(scene, (part,))
            found.append(part)
        except ValueError as error:
            why = why or str(error)
    return tuple(found), "" if found else why
