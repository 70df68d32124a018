"""Attacks on the pixels of an image, without a camera, for comparison."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from moireaug.attacks.loop import Attack
from moireaug.attacks.problem import Point, Problem
from moireaug.common.numeric import clip
from moireaug.scene.mixed_shot import MixedShot
from moireaug.scenes import Shot


@dataclass(eq=False)
class PixelProblem(Problem):
    """Noise on the pixels of images."""

    images: Tensor
    base: Tensor = field(init=False)

    def __post_init__(self) -> None:
        self.shape = tuple(self.images.shape)
        self.base = self.images if self.images.dtype == torch.float64 else self.images.float()
        self.effective_range = 0.0, 1.0

    def render(self, point: Point) -> Tensor:
        return clip(self.images + point["noise"]).to(self.images.dtype)

    def subset(self, rows: Tensor) -> PixelProblem:
        return PixelProblem(self.images[rows])


@dataclass(frozen=True, kw_only=True)
class PGD(Attack):
    """Projected gradient descent on pixels (Madry et al., 2018), from a uniform random start; see
    `Attack`.

    Raises:
        ValueError: a shot, which has no meaning here, or the rule "printed", which adds to a
            camera's reading.
    """

    random_start: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.rule == "printed":
            raise ValueError(
                "the rule 'printed' adds to a camera's reading; a pixel attack has none. Use "
                "'sign'."
            )

    def draw(
        self, images: Tensor, shot: Shot | MixedShot | None, generator: torch.Generator | None
    ) -> None:
        refuse_shot(shot)

    def problem(self, images: Tensor, shot: Any, generator: torch.Generator | None) -> Problem:
        return PixelProblem(images)


@dataclass(frozen=True, kw_only=True)
class BIM(PGD):
    """The basic iterative method (Kurakin et al., 2017): PGD that starts from no noise."""

    random_start: float = 0.0


@dataclass(frozen=True, kw_only=True)
class MIFGSM(PGD):
    """The momentum iterative method (Dong et al., 2018, Algorithm 1; there with
    `step_size = 1 / steps`)."""

    rule: str = "momentum"
    random_start: float = 0.0


def refuse_shot(shot: Shot | MixedShot | None) -> None:
    """Refuse a shot, which a pixel attack has no use for."""
    if shot is not None:
        raise ValueError(
            "a pixel attack has no camera: leave shot out, or use attacks.MoireAttack."
        )
