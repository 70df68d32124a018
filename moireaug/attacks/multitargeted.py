"""An attack run toward several classes in turn: MultiTargeted, and with it AutoAttack's APGD-T."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

import torch
from torch import Tensor

from moireaug.attacks.base import NamesForeignArguments
from moireaug.attacks.loop import Attack
from moireaug.attacks.losses import is_same_answer, likeliest_wrong_classes
from moireaug.attacks.result import Result
from moireaug.attacks.search import Search
from moireaug.common.argument_checks import check_whole
from moireaug.scene.mixed_shot import MixedShot
from moireaug.scenes import Shot


@dataclass(frozen=True, kw_only=True)
class MultiTargeted(NamesForeignArguments):
    """Run an attack toward each of the likeliest wrong classes of the unattacked photo in turn
    (Gowal et al., 2019).

    Any wrong class is a success, and ends the attack on an image, unless the model is random. For
    the other images the greatest margin is kept; with `eot`, of an expectation, for all that are
    right without noise, as no step sees the shot. With the rule "apgd" and the loss "dlr" it is
    APGD-T, the second attack of AutoAttack (Croce & Hein, 2020, section 5):
    `MultiTargeted(MoireAttack(model, rule="apgd", loss="dlr", steps=100))`.

    Args:
        attack: a MoireAttack, PGD or another `Attack`, whose loss steers toward the class.
        targets: number of classes, the likeliest first; where the model has no more than that, all
            but the label.

    Raises:
        TypeError, ValueError: another kind of attack, or `targets` that is no whole number above 0.
    """

    _example: ClassVar[str] = "targets=9"

    attack: Attack = field(kw_only=False)
    targets: int = 9

    def __post_init__(self) -> None:
        if not isinstance(self.attack, Attack):
            raise TypeError(
                "MultiTargeted runs an attack whose steps have a target, like MoireAttack or PGD; "
                f"got {self.attack!r}."
            )
        check_whole("targets", self.targets, 1, noun="the classes to go toward")

    def __call__(
        self,
        images: Tensor,
        labels: Tensor,
        targets: None = None,
        *,
        shot: Shot | MixedShot | None = None,
        generator: torch.Generator | None = None,
    ) -> Result:
        """Attack a batch; arguments, Result and errors as of `Attack`, but targets are refused.

        Photos that a deterministic model gets wrong without an attack are returned unchanged.
        `loss` in the Result is of the last class that was tried, over the images that were left.
        """
        if targets is not None:
            raise ValueError(
                "MultiTargeted chooses its own targets, the likeliest wrong classes: leave targets "
                "out, or pass them to a call of its attack."
            )
        run = self._run_toward_classes
        return self.attack.in_scenes(run, images, labels, None, shot, generator)

    def _run_toward_classes(self, search: Search) -> Result:
        """Run the attack toward each class in turn, on the images that are still right."""
        point = search.problem.clean_point()
        _, logits = search.images_and_logits(point)
        _, second_logits = search.images_and_logits(point)
        repeats = bool(is_same_answer(logits, second_logits).all())
        search.drops_fooled = repeats and self.attack.until_fooled
        search.keep(point, logits.repeat(search.problem.views, 1))
        if repeats:
            search.drop_fooled()
        is_expectation = search.problem.views > 1
        if is_expectation:  # the margin on this shot is none of its other draws'
            search.margins[search.rows] = -math.inf
        values, classes = likeliest_wrong_classes(logits, search.labels, self.targets)
        for value, targets in zip(values.T, classes.T, strict=True):
            search.drop(~value.isfinite())  # minus infinity rules a class out, and those after it
            if not len(search.rows):
                break
            search.loss_targets = targets
            self.attack.run_restarts(search)
            if repeats and not is_expectation:
                search.drop_fooled()
        return self.attack.result(search)
