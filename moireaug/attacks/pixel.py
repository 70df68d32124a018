"""Attacks on the pixels of an image, without a camera, for comparison; among them one that anybody
can see."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from moireaug.attacks.loop import Attack
from moireaug.attacks.problem import Point, Problem
from moireaug.common.argument_checks import is_finite
from moireaug.common.numeric import clip, widen_half


@dataclass(eq=False)
class PixelProblem(Problem):
    """Noise on the pixels of images."""

    images: Tensor
    base: Tensor = field(init=False)

    def __post_init__(self) -> None:
        self.shape = tuple(self.images.shape)
        self.base = widen_half(self.images)
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


@dataclass(eq=False)
class PatchProblem(PixelProblem):
    """Noise on the pixels within a mask (B, 1, H, W), 1 inside and 0 outside."""

    mask: Tensor

    def render(self, point: Point) -> Tensor:
        return clip(self.images + self.mask * point["noise"]).to(self.images.dtype)

    def start(self, radius: float, generator: torch.Generator | None, random_pose: bool) -> Point:
        point = super().start(radius, generator, random_pose)
        return {"noise": self.mask * point["noise"]}

    def subset(self, rows: Tensor) -> PatchProblem:
        return PatchProblem(self.images[rows], self.mask[rows])


@dataclass(frozen=True, kw_only=True)
class Patch(PGD):
    """An adversarial patch, after Brown et al. (2017): a disc whose pixels may take any colour.

    Theirs is one patch for all images, trained over places, scales and angles. This one is found
    for each image at one place, drawn from the generator, so it is as strong as a patch at that
    place can be. In the Result, `noise` is 0 outside of the disc.

    Args:
        eps: bound of a pixel's change in the disc; by default to any colour.
        area: area of the disc, as a share of the image's, above 0; the disc must fit into the
            image.

    Raises:
        ValueError: as of `PGD`; an area that is no share.
    """

    eps: float = 1.0
    random_start: float = 0.0
    area: float = 0.05

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (is_finite(self.area) and 0 < self.area < math.pi / 4):
            raise ValueError(
                f"area must be the disc's share of the image, above 0 and below pi / 4; "
                f"got {self.area!r}."
            )

    def problem(self, images: Tensor, shot: Any, generator: torch.Generator | None) -> PatchProblem:
        return PatchProblem(images, discs(images, self.area, generator))


def discs(images: Tensor, area: float, generator: torch.Generator | None = None) -> Tensor:
    """Return a disc at a random place in each image: (B, 1, H, W), 1 inside and 0 outside.

    Args:
        images: (B, 3, H, W) images.
        area: area of a disc, as a share of the image's.

    Raises:
        ValueError: images too long or too narrow for a disc of that area, or too small for it to
            hold a pixel.
    """
    n, _, height, width = images.shape
    radius = math.sqrt(area * height * width / math.pi)
    # a narrower one may lie between the centres of four pixels
    if not math.sqrt(2) <= 2 * radius <= min(height, width):
        raise ValueError(
            f"a disc must be at least 1.42 pixels wide and fit into the image; got "
            f"{2 * radius:.3g} pixels, {area:g} of the area of {width} x {height}. Choose another "
            "area."
        )
    place = torch.rand(n, 2, 1, 1, generator=generator, dtype=torch.float64, device="cpu")
    x = radius + place[:, 0] * (width - 2 * radius)
    y = radius + place[:, 1] * (height - 2 * radius)
    across = torch.arange(width, dtype=torch.float64, device="cpu") + 0.5 - x
    down = torch.arange(height, dtype=torch.float64, device="cpu").view(-1, 1) + 0.5 - y
    inside = across.square() + down.square() <= radius**2
    return inside.unsqueeze(1).to(images)
