"""The problem that an attack searches, and the Result that it returns."""

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
    """The result of an attack on a batch.

    Args:
        images: (B, 3, H, W) adversarial images in [0, 1], the best found per image.
        success: (B,) bool; True where the label is not predicted or, in a targeted attack, the
            target is. Logits that are NaN or infinite predict nothing.
        noise: noise of each image: of `Shot.raw_shape()` on a raw reading, (B, 3, H, W) on a photo
            or on pixels. In a mixture of scenes whose raw shapes differ, a list of B tensors, one
            per image.
        loss: (steps,) mean cross-entropy to the label (targeted: to the target) before each step of
            the last restart; with `until_fooled`, over the images that took it, and shorter where
            none was left. In a mixture, the mean of the scenes' own, weighted by their images.
        eps: the L-infinity bound of the noise. Under the rule "printed" it bounds delta, and
            `noise` may exceed it; see `rules.Printed`. For `CW`, which has no bound, the largest
            absolute noise.
        shot: the Shot of the photos, in a mixture a `MixedShot`; where a pose was searched, the
            shot at the best pose; None for pixel attacks. `capture(images, shot, noise)` takes all
            of these.
    """

    images: Tensor
    success: Tensor
    noise: Tensor | list[Tensor]
    loss: Tensor
    eps: float
    shot: Shot | MixedShot | None = None

    def __repr__(self) -> str:
        """Return a summary in one line, without the tensors."""
        n, fooled = len(self.success), int(self.success.sum())
        parts = [f"eps {255 * self.eps:.3g}/255", f"{fooled} of {n} images fooled"]
        if n and len(self.loss):
            steps = f"{len(self.loss)} step{'s' if len(self.loss) > 1 else ''}"
            parts.append(f"loss {self.loss[0]:.3g} to {self.loss[-1]:.3g} in {steps}")
        return f"Result({', '.join(parts)})"


# the variables of a search by name: "noise" and, where a pose is searched, "pose"
Point = dict[str, Tensor]


class Problem(NamedTuple):
    """How noise, and a pose where one is searched, become images.

    Args:
        render: function of `**point` that returns the photos (B, 3, H, W) that are judged.
        forward_views: function of `**point` that returns the photos (views * B, 3, H, W) whose loss
            a step ascends.
        shape: shape of the noise.
        images: (B, 3, H, W) attacked images.
        subset: function of indices (b,) that returns the problem of those images; only where
            `views` is 1.
        views: photos per image and step.
        shot: shot of the photos, or None.
        base: (B, ...) reading or image that the noise is added to, or None where it differs from
            step to step.
        effective_range: low and high end of base + noise, beyond which more noise changes no photo.
        mask: (B, 1, H, W) mask, 1 where noise changes the image and 0 elsewhere; None is
            everywhere.
        pose: (B, F) pose in [-1, 1] at which the search starts, or None.
        shot_at: function of a pose (B, F) that returns its shot, or None.
        frozen: names of the variables that no step moves.
    """

    render: Callable[..., Tensor]
    forward_views: Callable[..., Tensor]
    shape: tuple[int, ...]
    images: Tensor
    subset: Callable[[Tensor], Problem]
    views: int = 1
    shot: Shot | None = None
    base: Tensor | None = None
    effective_range: tuple[float, float] = (-math.inf, math.inf)
    mask: Tensor | None = None
    pose: Tensor | None = None
    shot_at: Callable[[Tensor], Shot] | None = None
    frozen: tuple[str, ...] = ()


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
