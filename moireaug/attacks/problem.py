"""What an attack searches, and what it returns."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from moireaug.mixed_shot import MixedShot
from moireaug.scenes import Shot


@dataclass(frozen=True, eq=False)
class Result:
    """What an attack found.

    Args:
        images: (B, 3, H, W) adversarial images in [0, 1], the best found per image.
        success: (B,) bool; True where the label is not predicted or, in a targeted attack, the
            target is. Logits that are NaN or infinite predict nothing.
        noise: what was added: raw noise of `Shot.raw_shape()` for MoireAttack, or, where its noise
            is at the photo, (B, 3, H, W); pixels (B, 3, H, W) for pixel attacks. In a mixture of
            scenes whose raw shapes differ, a list of B tensors, one per image.
        loss: (steps,) mean cross-entropy to the label (targeted: to the target) before each step of
            the last restart; with `until_fooled`, over the images that took it, and shorter where
            none was left. In a mixture, the mean of the scenes' own, weighted by their images.
        eps: the L-infinity bound of the noise. Under the rule "printed" it bounds delta, and
            `noise` may exceed it; see `rules.Printed`. For `CW`, which has no bound, the largest
            absolute noise.
        shot: the Shot of the photos, in a mixture a `MixedShot`; the one found, where a pose was
            searched; None for pixel attacks. `capture(images, shot, noise)` takes all of these.
    """

    images: Tensor
    success: Tensor
    noise: Tensor | list[Tensor]
    loss: Tensor
    eps: float
    shot: Shot | MixedShot | None = None

    def __repr__(self) -> str:
        """Return one line that sums up what was found, without the tensors."""
        n, fooled = len(self.success), int(self.success.sum())
        parts = [f"eps {255 * self.eps:.3g}/255", f"{fooled} of {n} images fooled"]
        if n and len(self.loss):
            steps = f"{len(self.loss)} step{'s' if len(self.loss) > 1 else ''}"
            parts.append(f"loss {self.loss[0]:.3g} to {self.loss[-1]:.3g} in {steps}")
        return f"Result({', '.join(parts)})"


# the variables of a search by name: "noise" and, where the camera turns, "pose"
Point = dict[str, Tensor]


class Problem(NamedTuple):
    """How noise, and a pose where one is searched, become images.

    Args:
        render: called with `**point`; returns the photos that are judged.
        rehearse: called with `**point`; returns the photos whose loss a step follows, `views` times
            as many.
        shape: of the noise.
        images: (B, 3, H, W), what is attacked.
        views: see `rehearse`.
        shot: of the photos, or None.
        base: (B, ...) what the noise is added to, or None where that differs from step to step.
        felt: the least and greatest values of base + noise, beyond which more noise changes no
            photo.
        reach: (B, 1, H, W), 1 where noise changes the image and 0 elsewhere; None is everywhere.
        pose: (B, F) where the search of a pose starts, in [-1, 1], or None.
        aim: from a pose to its shot, or None.
        still: variables that no step moves.
        part: from indices (b,) to the same problem for those images; only where `views` is 1.
    """

    render: Callable[..., Tensor]
    rehearse: Callable[..., Tensor]
    shape: tuple[int, ...]
    images: Tensor
    part: Callable[[Tensor], Problem]
    views: int = 1
    shot: Shot | None = None
    base: Tensor | None = None
    felt: tuple[float, float] = (-math.inf, math.inf)
    reach: Tensor | None = None
    pose: Tensor | None = None
    aim: Callable[[Tensor], Shot] | None = None
    still: tuple[str, ...] = ()


def noise_tensor(result: Result) -> Tensor:
    """Return a result's noise as one tensor, (B, ...).

    Raises:
        RuntimeError: noise of different shapes, in a mixture.
    """
    return result.noise if isinstance(result.noise, Tensor) else torch.stack(result.noise)


def single(result: Result | list[Result]) -> Result:
    """Return the result of an attack at one bound.

    Raises:
        TypeError: a list of results, from an attack at several bounds.
    """
    if isinstance(result, list):
        raise TypeError(f"eps must be one number here; got the results of {len(result)} bounds.")
    return result
