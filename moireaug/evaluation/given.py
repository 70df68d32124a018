"""What suites are built from, and the controls that stand beside every attack."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from moireaug.defenses import DEFENSES
from moireaug.evaluation.adaptive import Defence
from moireaug.evaluation.rungs import CLEAN, MOIRE, Model, Rung, random_noise
from moireaug.evaluation.sweep import Judge, behind
from moireaug.scene.scene import Scene


@dataclass(frozen=True, kw_only=True)
class Given:
    """What suites are built from.

    Args:
        scene: the evaluation's scene.
        eps: bound of the attacks that tables compare, in [0, 1] units. steps: gradient steps of every attack.
        targets: name to model for transfer; None where its weights are not at hand.
        defences: name to defence: by default the paper's; an image quilting, or a network that removes moiré, joins it.
        without: name to the reason why a defence is not there.
    """

    scene: Scene
    eps: float = 4 / 255
    steps: int = 20
    targets: Mapping[str, Model | None] = field(default_factory=dict)
    defences: Mapping[str, Defence] = field(default_factory=lambda: {k: make() for k, make in DEFENSES.items()})
    without: Mapping[str, str] = field(default_factory=dict)

    def judge(self, name: str) -> Judge:
        """The attacked model behind the defence of that name."""
        defence = self.defences[name]
        return behind(name, getattr(defence, "title", name), defence)


def controls(eps: float) -> dict[str, Rung]:
    """What stands beside every attack: the image itself, and its photo without and with noise that nobody searched."""
    return {"clean": CLEAN, "moiré, δ = 0": MOIRE, "random noise": random_noise(eps)}
