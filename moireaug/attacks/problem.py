"""What an attack searches: a point, and how it becomes images."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import torch
from torch import Tensor

from moireaug.attacks.bounds import Box
from moireaug.scenes import Shot

# the variables of a search by name: "noise", whose bound is eps whatever it counts (see
# `bounds.Box`), and, where a pose is searched, "pose"
Point = dict[str, Tensor]


class Problem(ABC):
    """How noise, and a pose where one is searched, become the images of one batch.

    Attributes:
        images: (B, 3, H, W) attacked images.
        shape: shape of the noise, (B, ...).
        views: photos per image and step.
        base: (B, ...) reading or image that the noise is added to, or None where it differs from
            step to step.
        effective_range: low and high end of base + noise, beyond which more noise changes no photo.
        box: noise on base that the variable "noise" stands for.
        unit: what eps counts, see `bounds.BOUNDS`.
        pose: (B, F) pose in [-1, 1] at which the search starts; None where none is searched.
        noise_frozen: whether the noise stays 0, because only the pose is searched.
    """

    images: Tensor
    shape: tuple[int, ...]
    views: int = 1
    base: Tensor | None = None
    effective_range: tuple[float, float] = (-math.inf, math.inf)
    box: Box = Box()
    unit: str = "codes"
    pose: Tensor | None = None
    noise_frozen: bool = False

    @abstractmethod
    def render(self, point: Point) -> Tensor:
        """Return the images (B, 3, H, W) that are judged."""

    def forward_views(self, point: Point) -> Tensor:
        """Return the images (views * B, 3, H, W) whose loss a step ascends."""
        return self.render(point)

    @abstractmethod
    def subset(self, rows: Tensor) -> Problem:
        """Return the problem of the images at indices (b,)."""

    def noise_of(self, point: Point) -> Tensor:
        """Return the noise at a point, in units of the reading or image that it is added to."""
        return point["noise"]

    def shot_of(self, point: Point) -> Shot | None:
        """Return the shot of the images at a point; None without a camera."""
        return None

    def noise_range(self) -> tuple[Tensor, Tensor] | None:
        """Return the low and high end of the variable "noise", beyond which it changes no photo,
        (B, ...) each; None where there are none, or base differs from step to step."""
        low, high = self.effective_range
        if self.base is None or (low, high) == (-math.inf, math.inf):
            return None
        return self.box.variable(low - self.base), self.box.variable(high - self.base)

    def clean_point(self) -> Point:
        """Return the point of no noise, at the pose that the search starts from."""
        dtype = torch.promote_types(self.images.dtype, torch.float32)
        point = {"noise": torch.zeros(self.shape, dtype=dtype, device=self.images.device)}
        if self.pose is not None:
            point["pose"] = self.pose
        return point

    def start(self, radius: float, generator: torch.Generator | None, random_pose: bool) -> Point:
        """Return a point of uniform random noise within `radius`, and perhaps at a random pose."""
        point = self.clean_point()
        if radius and not self.noise_frozen:
            noise = torch.empty(self.shape, dtype=torch.float32, device="cpu")
            noise = noise.uniform_(-radius, radius, generator=generator)
            point["noise"] = noise.to(point["noise"])
        if self.pose is not None and random_pose:
            shape, dtype = self.pose.shape, torch.float64
            fraction = torch.rand(shape, generator=generator, dtype=dtype, device="cpu")
            point["pose"] = (fraction * 2 - 1).to(self.pose.device)
        return point
