"""Attacks on the pixels of an image that no camera saw: the rivals."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from moireaug.attacks.loop import Attack, Problem
from moireaug.effects.tone import clip
from moireaug.shot import Shot


@dataclass(frozen=True, kw_only=True)
class PGD(Attack):
    """Projected gradient descent on pixels (Madry et al., 2018), from a uniform random start; see `Attack`.

    Raises:
        ValueError: a shot, which has no meaning here.
    """

    random_start: float = 1.0

    def problem(self, images: Tensor, shot: Shot | None, generator: torch.Generator | None) -> Problem:
        if shot is not None:
            raise ValueError("a pixel attack has no camera: leave shot out, or use attacks.MoireAttack.")

        def render(noise: Tensor) -> Tensor:
            return clip(images + noise).to(images.dtype)

        return Problem(render, render, tuple(images.shape))
