"""A call of an attack: its arguments checked, those of other libraries named, its shot drawn, and a
search in each scene."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

import torch
from torch import Tensor, nn

from moireaug.attacks.checks import check_goals
from moireaug.attacks.model import evaluating
from moireaug.attacks.problem import Problem
from moireaug.attacks.result import Result, join_results
from moireaug.attacks.search import Search
from moireaug.common.argument_checks import check_callable
from moireaug.common.image_checks import check_images
from moireaug.scene.mixed_shot import MixedShot, join_rows, per_scene
from moireaug.scenes import Shot

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
    """Base of attacks: an argument of other libraries is refused with the one that stands for it,
    and settings without their names with the way to write them.

    Raises:
        TypeError: such an argument, or such settings.
    """

    _example: ClassVar[str] = "eps=8/255"  # a setting

    def __new__(cls, *unnamed: Any, **settings: Any) -> Self:
        taken = getattr(cls, "__match_args__", ())  # the fields without a name: the model
        if len(unnamed) > len(taken):
            call = f"{cls.__name__}({', '.join((*taken, cls._example))})"
            raise TypeError(
                f"{cls.__name__} takes its settings by name, as {call}; got "
                f"{unnamed[len(taken)]!r} without one."
            )
        for name in settings:
            if name in ARGUMENT_ADVICE and name not in getattr(cls, "__dataclass_fields__", {}):
                raise TypeError(
                    f"{cls.__name__} has no argument {name!r}: {ARGUMENT_ADVICE[name]}."
                )
        return super().__new__(cls)


@dataclass(frozen=True, kw_only=True)
class ModelAttack(NamesForeignArguments, ABC):
    """An attack on a model: a subclass defines the problem of a batch, and the search in it."""

    has_bound: ClassVar[bool] = True  # eps

    model: nn.Module | Callable[[Tensor], Tensor] = field(kw_only=False, repr=False)

    def __post_init__(self) -> None:
        check_callable("an attack's model", self.model)

    @abstractmethod
    def problem(self, images: Tensor, shot: Any, generator: torch.Generator | None) -> Problem:
        """Return the problem of images in one scene: how noise becomes its images."""

    @abstractmethod
    def attack(self, search: Search) -> Result:
        """Search, and return the Result."""

    def draw(
        self, images: Tensor, shot: Shot | MixedShot | None, generator: torch.Generator | None
    ) -> Shot | MixedShot | None:
        """Return the shot of a batch, given or drawn. Without a camera, one is refused."""
        if shot is not None:
            raise ValueError(
                "a pixel attack has no camera: leave shot out, or use attacks.MoireAttack."
            )
        return None

    def starting_at(self, search: Search) -> Search:
        """Return the search that is run in a scene: as it is, or one of other shots."""
        return search

    def __call__(
        self,
        images: Tensor,
        labels: Tensor,
        targets: Tensor | None = None,
        *,
        shot: Shot | MixedShot | None = None,
        generator: torch.Generator | None = None,
    ) -> Result:
        """Attack a batch.

        Args:
            images: (B, 3, H, W) float in [0, 1].
            labels: (B,) int64 true classes.
            targets: (B,) int64 classes to reach; None is untargeted.
            shot: parameters of the photo that is attacked, in its own scene; None draws them.
            generator: CPU generator of that draw and of random starts; None is torch's global one.

        Raises:
            TypeError, ValueError: images, labels or logits of the wrong type, shape or range;
                targets that equal their labels; a model without a gradient, or whose logits are not
                finite for any of the images; a shot of an attack without a camera.
        """
        return self.in_scenes(self.attack, images, labels, targets, shot, generator)

    def in_scenes(
        self,
        run: Callable[[Search], Any],
        images: Tensor,
        labels: Tensor,
        targets: Tensor | None,
        shot: Shot | MixedShot | None,
        generator: torch.Generator | None,
    ) -> Any:
        """Return what `run` makes of a search of the images in each scene, a tensor (b, ...) or a
        Result, in the order of the batch; other arguments, errors: as of a call. Each search begins
        where the one before it has ended, as all draw from one generator."""
        images = check_images(images)
        with evaluating(self.model, images):
            images = images.detach().clone()
            labels, targets = check_goals(images, labels, targets)
            drawn: Any = self.draw(images, shot, generator)

            def run_in_scene(
                shot: Shot, images: Tensor, labels: Tensor, targets: Tensor | None
            ) -> Any:
                problem = self.problem(images, shot, generator)
                search = Search(self.model, problem, labels, targets, generator)
                return run(self.starting_at(search))

            def join(rows: list[Tensor], parts: list[Any]) -> Any:
                if isinstance(parts[0], Tensor):
                    return join_rows(rows, parts)
                return join_results(drawn, rows, parts, getattr(self, "noise_at", "raw"))

            return per_scene(drawn, run_in_scene, images, labels, targets, join=join)
