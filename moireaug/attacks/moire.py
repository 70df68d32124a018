"""The Moiré Attack: noise on the raw reading of a photographed screen."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from moireaug.attacks.loop import Attack, Problem
from moireaug.capture import develop, expose
from moireaug.scene import Scene, as_scene
from moireaug.shot import Shot


@dataclass(frozen=True, kw_only=True)
class MoireAttack(Attack):
    """The Moiré Attack (paper, section 3 and Algorithm 1): find delta on the raw reading so that the developed photo
    `develop(expose(x) + delta)` is misclassified, or classified as a target.

    The screen is exposed once; every step only develops raw + delta. Unlike the printed algorithm, each step's photo is
    developed from the one reading plus the current delta, and the best step per image is returned.

    Args:
        scene: a Scene, a preset's name or a dict.
        eot: shots a step; with more than one, each step averages over so many fresh draws of the scene (expectation
            over transformation), and the noise found is judged on `shot` alone. 1 attacks that very shot.
        others: see `Attack`.
    """

    scene: Scene | str | dict = "paper"
    eot: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "scene", as_scene(self.scene))
        if isinstance(self.eot, bool) or not isinstance(self.eot, int) or self.eot < 1:
            raise ValueError(f"eot must be an integer >= 1, the shots of a step; got {self.eot!r}.")

    def problem(self, images: Tensor, shot: Shot | None, generator: torch.Generator | None) -> Problem:
        size = tuple(images.shape[-2:])
        if shot is None:
            shot = self.scene.sample(len(images), size, generator)
        with torch.no_grad():
            raw = expose(images, shot)

        def render(noise: Tensor) -> Tensor:
            return develop(raw + noise, shot).to(images.dtype)

        def rehearse(noise: Tensor) -> Tensor:
            draws = self.scene.sample(self.eot * len(images), size, generator)
            with torch.no_grad():
                fresh = expose(images.repeat(self.eot, 1, 1, 1), draws)
            return develop(fresh + noise.repeat(self.eot, 1, 1, 1), draws).to(images.dtype)

        shape = shot.raw_shape()
        if self.eot == 1:
            return Problem(render, render, shape, 1, shot)
        return Problem(render, rehearse, shape, self.eot, shot)
