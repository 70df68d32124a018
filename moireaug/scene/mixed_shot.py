"""One draw from a mixture of scenes for a batch of images, as data."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, Self, TypeVar

import torch
from torch import Tensor

from moireaug.scene.draws import Draws, check_drawn
from moireaug.scene.shot import ShotRecord, check_tensor

S = TypeVar("S", bound=ShotRecord)


@dataclass(frozen=True, eq=False, kw_only=True)
class MixedShot(Draws, Generic[S]):
    """The draw of a `Mixture` for a batch: each image's scene, and its numbers in that scene.
    `capture` takes it as it takes a Shot. Index it like a batch; `by_scene` gives it as Shots.

    Args:
        scenes: the Scenes of the mixture.
        scene_index: (B,) int64, the index of each image's scene.
        size: height and width of the images.
        drawn: the drawn numbers by name, such as "view.yaw", (B,) float64 each: all scenes have the
            same fields.
        seed: (B,) int64, the seeds of the sensor noise.
    """

    scenes: tuple[Any, ...]
    scene_index: Tensor
    size: tuple[int, int]
    drawn: dict[str, Tensor]
    seed: Tensor

    def __post_init__(self) -> None:
        check_drawn({"scene_index": self.scene_index, **self.drawn}, self.seed)

    @staticmethod
    def from_shots(
        scenes: tuple[Any, ...], scene_index: Tensor, shots: Sequence[tuple[Tensor, S]]
    ) -> MixedShot[S]:
        """Return the inverse of `by_scene`: one or more shots, and the rows of each."""
        numbers = [shot.numbers() for _, shot in shots]
        seed = torch.cat([shot.seed for _, shot in shots])
        order = torch.cat([rows for rows, _ in shots]).argsort().to(seed.device)
        drawn = {name: torch.cat([one[name] for one in numbers])[order] for name in numbers[0]}
        index, size = scene_index.to(seed.device), shots[0][1].size
        return MixedShot(scenes=scenes, scene_index=index, size=size, drawn=drawn, seed=seed[order])

    def map_rows(self, f: Callable[[Tensor], Tensor]) -> Self:
        drawn = {name: f(values) for name, values in self.drawn.items()}
        index, seed = f(self.scene_index), f(self.seed)
        return dataclasses.replace(self, scene_index=index, drawn=drawn, seed=seed)

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
            raise RuntimeError(
                "torch.compile cannot follow which image is in which scene: call the transform "
                "outside of the compiled function, or give it one scene."
            )
        parts = rows_by_scene(self.scene_index, len(self.scenes))
        if sum(len(rows) for _, rows in parts) != len(self):
            raise ValueError(
                f"a mixture of {len(self.scenes)} scenes numbers them from 0 to "
                f"{len(self.scenes) - 1}; got {self.scene_index.tolist()}. Was it drawn by another "
                "one?"
            )
        return [(rows, self._shot_in(k, rows)) for k, rows in parts]

    def _shot_in(self, k: int, rows: Tensor) -> S:
        """Return the shot of some rows in scene k."""
        numbers = {name: values[rows] for name, values in self.drawn.items()}
        return self.scenes[k].shot_from_numbers(self.size, numbers, self.seed[rows])

    @property
    def moves(self) -> bool:
        """Whether points may move from image to photo, in any of the scenes."""
        return any(scene.moves for scene in self.scenes)

    def to_photo(self, points: Tensor) -> Tensor:
        """Return where points (B, N, 2) of the image lie in the photo; see `Shot.to_photo`."""
        self._check_rows(points, "points")
        return per_scene(self, ShotRecord.to_photo, points)

    def to_photo_mask(self, mask: Tensor) -> Tensor:
        """Return a mask (B, C, H, W) of the image as in the photo; see `Shot.to_photo_mask`."""
        self._check_rows(mask, "a mask")
        return per_scene(self, ShotRecord.to_photo_mask, mask)

    def _check_rows(self, values: Tensor, name: str) -> None:
        check_tensor(name, values)
        if values.ndim == 0 or len(values) != len(self):
            raise ValueError(
                f"{name} must have a row for each of the {len(self)} images of the shot; got the "
                f"shape {tuple(values.shape)}."
            )

    def raw_shapes(self) -> set[tuple[int, ...]]:
        """Return the shapes (planes, h, w) of a reading in the mixture's scenes."""
        none = self.scene_index[:0]
        return {self._shot_in(k, none).raw_shape()[1:] for k in range(len(self.scenes))}

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


def rows_by_scene(scene_index: Tensor, n: int) -> list[tuple[int, Tensor]]:
    """Return the index of each of n scenes that has images and their rows (b,), ascending; of the
    first, where there is no image at all."""
    rows = [(k, (scene_index == k).nonzero().flatten()) for k in range(n)]
    return [(k, found) for k, found in rows if len(found)] or rows[:1]


def per_scene(
    shot: ShotRecord | MixedShot, f: Callable[..., Any], *tensors: Any, join: Any = None
) -> Any:
    """Return f(shot, *tensors) of the images in each scene, in the order of the batch.

    f: takes a shot of one scene, and its images' rows of the tensors; returns (b, ...).
    tensors: (B, ...) each, or a list of B tensors, whose rows are stacked, or None.
    join: makes one result of the rows (b,) and the results of each scene; default `join_rows`.
    """
    if not isinstance(shot, MixedShot):
        return f(shot, *tensors)
    parts = shot.by_scene()
    results = [f(part, *[_rows_of(t, rows) for t in tensors]) for rows, part in parts]
    return (join or join_rows)([rows for rows, _ in parts], results)


def _rows_of(values: Tensor | Sequence[Tensor] | None, rows: Tensor) -> Tensor | None:
    if isinstance(values, Tensor):
        return values[rows.to(values.device)]
    if values is None or not len(rows):
        return None
    return torch.stack([values[row] for row in rows.tolist()])


def join_rows(rows: Sequence[Tensor], parts: Sequence[Tensor]) -> Tensor:
    """Return the rows (b,) of several tensors (b, ...), together every index from 0 once, as one
    tensor."""
    order, joined = torch.cat(list(rows)).argsort(), torch.cat(list(parts))
    return joined[order.to(joined.device)]
