"""Attackers: conditions that search for noise that fools the model."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from moireaug.attacks import ATTACKS, MoireAttack, NoAnswerError
from moireaug.attacks.result import Result
from moireaug.capture import capture
from moireaug.common.argument_checks import one_of
from moireaug.evaluation.classifiers import UNDEFENDED, Classifier
from moireaug.evaluation.conditions import Condition, EvalBatch, in_255ths
from moireaug.evaluation.visibility import visibility

PIXEL_ATTACKS = tuple(name for name in ATTACKS if not issubclass(ATTACKS[name], MoireAttack))
EVERY_STEP = "in_every_step"  # in the name of an attacker that goes on once an image is fooled


@dataclass(frozen=True, kw_only=True)
class Attacker(Condition):
    """An attack at one bound.

    Args:
        eps: bound of the noise, in [0, 1] units.
        steps: number of gradient steps, or of queries.
        known_classifier: classifier whose defence is attacked, with the defence's own approximate
            gradient (BPDA) and by expectation over its draws where it is randomised (EOT). The
            model behind it is always the evaluated one.

    Raises:
        ValueError: a known_classifier of another model, or that restores the mean.
    """

    control: ClassVar[bool] = False
    on_screen: ClassVar[bool] = True  # the noise is on the reading of a photo

    eps: float = dataclasses.field()  # or it would have the 0 of its base
    steps: int
    known_classifier: Classifier = UNDEFENDED

    def __post_init__(self) -> None:
        super().__post_init__()
        known = self.known_classifier
        if known.model is not None or known.restores_mean:
            setting = "restores_mean" if known.model is None else "model"
            raise ValueError(
                "known_classifier says which defence of the evaluated model is attacked; got "
                f"{known.name!r}, whose {setting} no attack goes through. Leave {setting} out, or "
                "evaluate that model itself."
            )

    @property
    def base_name(self) -> str:
        words = self.name_words
        if self.known_classifier.defence is not None:
            words += ["through", self.known_classifier.name]
        return "_".join(filter(None, words))

    @property
    def name_words(self) -> list[str]:
        """The words of the name that tell attack and bound; empty ones are left out."""
        return [self.kind, in_255ths(self.eps), "targeted" if self.targeted else ""]

    @abstractmethod
    def attack_on(self, batch: EvalBatch) -> Callable[..., Result]:
        """Return the attack on the batch's model."""

    def perturb(self, batch: EvalBatch) -> Tensor:
        """Return the adversarial images, (B, 3, H, W), for the batch's model.

        Raises:
            NoAnswerError: the model has no answer to any of the images.
        """
        return self.result_of(self.attack_on(batch), batch).images

    def result_of(self, attack: Callable[..., Result], batch: EvalBatch) -> Result:
        """Return the result of an attack on the images of a batch."""
        goals = (batch.labels, batch.targets) if self.targeted else (batch.labels,)
        shot = batch.shot if self.on_screen else None
        return attack(batch.images, *goals, shot=shot, generator=batch.generator)

    @property
    def n_splits(self) -> int:
        """Number of splits of a batch that are attacked in turn: an expectation over n draws takes
        n times the images, and no step shall hold more than a batch."""
        return self.known_classifier.draws

    def show(self, batch: EvalBatch) -> Tensor:
        model = self.known_classifier.defended(batch.model, batch.max_images)
        batch = dataclasses.replace(batch, model=model)
        size = -(-len(batch.images) // self.n_splits)
        images = []
        for first in range(0, len(batch.images), size):
            split = batch[first : first + size]
            try:
                images.append(self.perturb(split))
            except NoAnswerError:  # wrong without an attack: the evaluation goes on
                images.append(self.unattacked(split))
        return torch.cat(images)

    def eps_unit(self, bound: str) -> str:
        return bound if self.on_screen else "codes"

    def unattacked(self, batch: EvalBatch) -> Tensor:
        """Return the images without an attack."""
        return capture(batch.images, batch.shot) if self.on_screen else batch.images

    def moire_attack(
        self, batch: EvalBatch, kind: type[MoireAttack] = MoireAttack, **settings: Any
    ) -> MoireAttack:
        """Return a Moiré Attack of that class on the batch's model, in the scene of its shots."""
        settings |= {"scene": batch.shot.scene, "bound": batch.bound}
        return kind(batch.model, eps=self.eps, steps=self.steps, **settings)

    def measure(self, batch: EvalBatch, images: Tensor) -> dict[str, list[float]]:
        return visibility(images, self.unattacked(batch), batch.lpips)


@dataclass(frozen=True, kw_only=True)
class MoireAttacker(Attacker):
    """The Moiré Attack on the photo that is classified, all of whose parameters it knows.

    Args:
        variant: word that the name of a special attacker adds.
        rule, loss, restarts, noise_at, optimise, draws: as of `attacks.MoireAttack`.
        until_fooled: the same; False where other classifiers see the noise, or where it is measured
            at its strongest.
    """

    kind = "ma"
    variant: str = ""
    rule: str = "sign"
    loss: str = "ce"
    restarts: int = 1
    noise_at: str = "raw"
    optimise: tuple[str, ...] = ("noise",)
    draws: int = 1
    until_fooled: bool = True

    @property
    def name_words(self) -> list[str]:
        return [*super().name_words, self.variant, "" if self.until_fooled else EVERY_STEP]

    def attack_on(self, batch: EvalBatch) -> MoireAttack:
        return self.moire_attack(
            batch,
            rule=self.rule,
            loss=self.loss,
            restarts=self.restarts,
            noise_at=self.noise_at,
            optimise=self.optimise,
            draws=self.draws,
            until_fooled=self.until_fooled,
        )

    def eps_unit(self, bound: str) -> str:
        return bound if self.noise_at == "raw" else "codes"  # a photo is codes

    def measure(self, batch: EvalBatch, images: Tensor) -> dict[str, list[float]]:
        if self.optimise != ("noise",) or self.draws > 1:
            return {}  # the photo without noise is of another shot
        return super().measure(batch, images)


@dataclass(frozen=True, kw_only=True)
class PhotoUnknownAttacker(Attacker):
    """The Moiré Attack by expectation over other draws of the scene. Its noise is shown on the
    photo that is classified, which no step has seen, at the same fraction of each value's own
    bound.

    Args:
        shots: number of draws in each step.
    """

    kind = "photo_unknown"
    shots: int = 4

    @property
    def n_splits(self) -> int:
        return self.shots * self.known_classifier.draws

    def attack_on(self, batch: EvalBatch) -> MoireAttack:
        return self.moire_attack(batch, eot=self.shots)


@dataclass(frozen=True, kw_only=True)
class PixelAttacker(Attacker):
    """An attack on the pixels of the image, without a camera, for comparison.

    Args:
        attack: one of `PIXEL_ATTACKS`; of these "cw" has no bound, and its eps must be 0.
        until_fooled: as of `MoireAttacker`; "cw" takes every step.

    Raises:
        ValueError: another attack, or an eps of "cw".
    """

    kind = "pixels"
    on_screen: ClassVar[bool] = False
    attack: str
    until_fooled: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        one_of("attack", self.attack, PIXEL_ATTACKS)
        if not self.has_bound and self.eps:
            raise ValueError(
                f"the attack {self.attack!r} has no bound, which its rows state as eps = 0; "
                f"got {self.eps}. Pass eps=0, or another attack."
            )

    @property
    def has_bound(self) -> bool:
        """Whether the attack has a bound, and may end where an image is fooled."""
        return ATTACKS[self.attack].has_bound

    @property
    def name_words(self) -> list[str]:
        if not self.has_bound:
            return [self.attack]
        _, *others = super().name_words
        return [self.attack, *others, "" if self.until_fooled else EVERY_STEP]

    def attack_on(self, batch: EvalBatch) -> Callable[..., Result]:
        settings: dict[str, Any] = {"steps": self.steps}
        if self.has_bound:
            settings |= {"eps": self.eps, "until_fooled": self.until_fooled}
        return ATTACKS[self.attack](model=batch.model, **settings)
