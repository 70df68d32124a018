"""One draw from a mixture of scenes for a batch of images, as data."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, Self, TypeVar

import torch
from torch import Tensor

from moireaug.scene.by_name import parts_with
from moireaug.scene.record import SceneRecord
from moireaug.shot import Draws, ShotRecord

S = TypeVar("S", bound=ShotRecord)
UNFOLLOWED = (
    "torch.compile cannot follow which image is in which scene: call the transform outside of the "
    "compiled function, or give it one scene."
)


@dataclass(frozen=True, eq=False, kw_only=True)
class MixedShot(Draws, Generic[S]):
    """What a `Mixture` draws for a batch: the scene of each image, and its numbers in that scene.

    `capture` takes it as it takes a Shot. Index it like a batch; `by_scene` gives it as Shots.

    Args:
        empty: a shot of no image in each scene of the mixture.
        which: (B,) int64, the index of each image's scene.
        size: height and width of the images.
        drawn: the drawn numbers by name, such as "view.yaw", (B,) float64 each: all scenes have the
            same fields.
        seed: (B,) int64, the seeds of the sensor noise.
    """

    empty: tuple[S, ...]
    which: Tensor
    size: tuple[int, int]
    drawn: dict[str, Tensor]
    seed: Tensor

    @staticmethod
    def joined(
        empty: tuple[S, ...], which: Tensor, shots: Sequence[tuple[Tensor, S]]
    ) -> MixedShot[S]:
        """Return the inverse of `by_scene`: one or more shots and the rows of each, which together
        are all rows of `which`."""
        rows = [at for at, _ in shots]
        numbers = [shot.numbers() for _, shot in shots]
        drawn = {}
        for name in numbers[0]:
            drawn[name] = in_order(rows, [one[name] for one in numbers])
        seed = in_order(rows, [shot.seed for _, shot in shots])
        size = shots[0][1].size
        which = which.to(seed.device)
        return MixedShot(empty=empty, which=which, size=size, drawn=drawn, seed=seed)

    @property
    def scenes(self) -> tuple[SceneRecord, ...]:
        """The scenes of the mixture."""
        return tuple(shot.scene for shot in self.empty)

    def map_rows(self, f: Callable[[Tensor], Tensor]) -> Self:
        drawn = {name: f(values) for name, values in self.drawn.items()}
        return dataclasses.replace(self, which=f(self.which), drawn=drawn, seed=f(self.seed))

    def numbers(self) -> dict[str, Tensor]:
        """Return the drawn numbers, (B,) each, by name."""
        return dict(self.drawn)

    def by_scene(self) -> list[tuple[Tensor, S]]:
        """Return the rows (b,) of the images in each scene, ascending, and their Shot. Scenes
        without an image are left out, but for the first where there is no image at all.

        Raises:
            ValueError: an image whose scene is none of the mixture's.
            RuntimeError: within torch.compile.
        """
        if torch.compiler.is_compiling():
            raise RuntimeError(UNFOLLOWED)
        parts = []
        for k in range(len(self.empty)):
            rows = (self.which == k).nonzero().flatten()
            if len(rows):
                parts.append((rows, self._in(k, rows)))
        if sum(len(rows) for rows, _ in parts) != len(self):
            raise ValueError(
                f"a mixture of {len(self.empty)} scenes numbers them from 0 to "
                f"{len(self.empty) - 1}; got {self.which.tolist()}. Was it drawn by another one?"
            )
        return parts or [(self.which, self._in(0, self.which))]

    def _in(self, k: int, rows: Tensor) -> S:
        """Return the shot of some rows in scene k."""
        numbers = {name: values[rows] for name, values in self.drawn.items()}
        parts = parts_with(self.empty[k], numbers)
        return dataclasses.replace(self.empty[k], size=self.size, seed=self.seed[rows], **parts)

    def gathered(self, f: Callable[[Tensor, S], Tensor]) -> Tensor:
        """Return f(rows, shot) of each scene's images, (b, ...), in the order of the batch."""
        every_rows, parts = [], []
        for rows, shot in self.by_scene():
            every_rows.append(rows)
            parts.append(f(rows, shot))
        return in_order(every_rows, parts)

    @property
    def moves(self) -> bool:
        """Whether points may move from image to photo: in any of the mixture's scenes."""
        return any(scene.moves for scene in self.scenes)

    def to_photo(self, points: Tensor) -> Tensor:
        """Return where points (B, N, 2) of the image lie in the photo; see `Shot.to_photo`."""
        self._check_rows(points, "points")
        return self.gathered(lambda rows, shot: shot.to_photo(points[rows.to(points.device)]))

    def to_photo_mask(self, mask: Tensor) -> Tensor:
        """Return a mask (B, C, H, W) of the image as in the photo; see `Shot.to_photo_mask`."""
        self._check_rows(mask, "a mask")
        return self.gathered(lambda rows, shot: shot.to_photo_mask(mask[rows.to(mask.device)]))

    def _check_rows(self, values: Tensor, name: str) -> None:
        if values.ndim == 0 or len(values) != len(self):
            raise ValueError(
                f"{name} must have a row for each of the {len(self)} images of the shot; got the "
                f"shape {tuple(values.shape)}."
            )

    def raw_shapes(self) -> set[tuple[int, ...]]:
        """Return the shapes (planes, h, w) of a reading in the mixture's scenes."""
        none = self.which[:0]
        return {self._in(k, none).raw_shape()[1:] for k in range(len(self.empty))}

    def raw_shape(self) -> tuple[int, ...]:
        """Return the shape of the raw reading, (B, planes, h, w); see `Shot.raw_shape`.

        Raises:
            ValueError: scenes whose readings have different shapes.
        """
        shapes = self.raw_shapes()
        if len(shapes) > 1:
            raise ValueError(
                f"the scenes of this mixture have raw readings of different shapes, "
                f"{', '.join(map(str, sorted(shapes)))}, which no tensor holds: go through the "
                "scenes by shot.by_scene()."
            )
        return len(self), *shapes.pop()


def in_order(rows: Sequence[Tensor], parts: Sequence[Tensor]) -> Tensor:
    """Return the rows of several tensors as one, each where it belongs.

    Args:
        rows: (b,) of each part, together every index from 0 once. parts: (b, ...) each.
    """
    order, joined = torch.cat(list(rows)).argsort(), torch.cat(list(parts))
    return joined[order.to(joined.device)]
