"""One draw from a scene for a batch of images, as data."""

from __future__ import annotations

import dataclasses
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Self

import numpy as np
import torch
from torch import Tensor

from moireaug.common.numeric import as_dtype
from moireaug.scene.by_name import by_part, parts_with, values_of
from moireaug.scene.develop import DEMOSAIC_REACH
from moireaug.scene.drawn_parts import DrawnDevelop, DrawnLens, DrawnPanel, DrawnSensor, DrawnView
from moireaug.scene.draws import Draws, check_drawn, check_size
from moireaug.scene.geometry import lattice
from moireaug.scene.geometry.grids import mask_in_photo, points_in_photo
from moireaug.scene.geometry.homography import about_corners
from moireaug.scene.plan import Plan
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot_geometry import HostGeometry, ShotGeometry


def check_tensor(name: str, values: object) -> Tensor:
    """Return values that are a tensor; refuse others with a TypeError."""
    if not isinstance(values, Tensor):
        raise TypeError(
            f"{name} must be a torch.Tensor; got {type(values).__name__}. Convert it with "
            "torch.as_tensor."
        )
    return values


def sampled_rows_and_columns(
    scene: SceneRecord, size: tuple[int, int], *, needs_every_pixel: bool
) -> tuple[lattice.SampledPixels, lattice.SampledPixels]:
    """Return which sensor rows and columns a photo of `size` (height, width) reads; of a binned
    reading, its cells.

    needs_every_pixel: see `Plan`.
    """
    if scene.is_binned:
        return lattice.binned_pixels(size[0]), lattice.binned_pixels(size[1])
    sensor, develop = scene.sensor, scene.develop
    reach = DEMOSAIC_REACH[develop.demosaic] if sensor.cfa == "rggb" else 0
    resize = "all" if needs_every_pixel else develop.resize
    rows, cols = (lattice.sampled_pixels(n, sensor.scale, resize, reach) for n in size)
    return rows, cols


class WholeImage(NamedTuple):
    """The image of which another is a part: its height and width, and the row and column at which
    the part begins."""

    size: tuple[int, int]
    corner: tuple[int, int]


@dataclass(frozen=True, eq=False, kw_only=True)
class ShotRecord(Draws, ShotGeometry[Tensor]):
    """The five parts with each ranged field a `(B,)` float64 tensor, scene, image size, and the
    plan of that scene at that size; users hold a `Shot`, which makes the plan.

    part_of: the larger image of whose photo this is the shot of a part, if any; see `crop`.
    """

    scene: SceneRecord
    size: tuple[int, int]
    panel: DrawnPanel
    view: DrawnView
    lens: DrawnLens
    sensor: DrawnSensor
    develop: DrawnDevelop
    seed: Tensor
    part_of: WholeImage | None = None
    plan: Plan = field(init=False, repr=False)
    _numbers: dict[str, Tensor] = field(init=False, repr=False)  # which a photo asks for often

    def __post_init__(self) -> None:
        """Check the drawn numbers, bring those of another dtype to float64, differentiably, and the
        size to a tuple."""
        object.__setattr__(self, "size", check_size(self.size))
        if self.part_of is not None:
            self._check_part(self.part_of.size, self.corner, self.size)
        if self.scene.is_crop and self.view.fit:  # which is not read: its screen goes on
            object.__setattr__(self, "view", self.view.drawn({"fit": False}))
        numbers = values_of(self)
        check_drawn(numbers, self.seed)
        if any(values.dtype != torch.float64 for values in numbers.values()):
            numbers = {name: values.double() for name, values in numbers.items()}
            for name, part in parts_with(self, numbers).items():
                object.__setattr__(self, name, part)
        object.__setattr__(self, "_numbers", numbers)

    def map_rows(self, f: Callable[[Tensor], Tensor]) -> Self:
        numbers = {name: f(values) for name, values in self.numbers().items()}
        return self.with_numbers(numbers, f(self.seed))

    def with_numbers(self, numbers: Mapping[str, Tensor], seed: Tensor) -> Self:
        """Return the shot of other numbers, (B,) float64 each by name, and seeds, (B,) int64."""
        return dataclasses.replace(self, **parts_with(self, numbers), seed=seed)

    @property
    def requires_grad(self) -> bool:
        """Whether any drawn number requires a gradient."""
        return any(values.requires_grad for values in self.numbers().values())

    def host_geometry(self, table: np.ndarray | None = None) -> HostGeometry:
        """Return the shot's geometry in arrays; table: from `host_numbers`, if it is at hand."""
        return HostGeometry(self, self.host_numbers() if table is None else table)

    @property
    def whole_size(self) -> tuple[int, int]:  # type: ignore[override]
        """Height and width of the image, or of the larger one of which it is a part."""
        return self.size if self.part_of is None else self.part_of.size

    @property
    def corner(self) -> tuple[int, int]:  # type: ignore[override]
        """Row and column at which the image begins in the larger one of which it is a part."""
        return (0, 0) if self.part_of is None else self.part_of.corner

    @property
    def is_dark_around(self) -> bool:
        """Whether photos show the dark around the picture."""
        return self.scene.is_dark_around and self.part_of is None

    def crop(self, top: int, left: int, height: int, width: int) -> Self:
        """Return the shot of a part of the image: the rows from `top` and the columns from `left`
        of the photo, which has the perspective, lens, vignetting and phase of the pattern that the
        whole photo has there.

        `capture(images[:, :, top : top + height, left : left + width], shot.crop(...))` equals that
        part of `capture(images, shot)`, but near its edges, past which the part's outermost pixels
        are repeated, and for the sensor noise and JPEG blocks. Photos in the camera's frame show
        there what their part of the image holds.

        Raises:
            TypeError: anything but whole numbers.
            ValueError: a part that the image does not hold, or a shot of a full reading.
        """
        given = top, left, height, width
        try:
            top, left, height, width = map(operator.index, given)
        except TypeError:
            raise TypeError(
                "a part's top, left, height and width must be whole numbers of pixels; got "
                f"{given}. Divide by //."
            ) from None
        self._check_part(self.size, (top, left), (height, width))
        whole = WholeImage(self.whole_size, (self.corner[0] + top, self.corner[1] + left))
        return dataclasses.replace(self, size=(height, width), part_of=whole)

    def _check_part(
        self, whole: tuple[int, int], corner: tuple[int, int], size: tuple[int, int]
    ) -> None:
        """Refuse, with a ValueError, a part that an image does not hold, or of a full reading."""
        (h, w), (top, left), (height, width) = whole, corner, size
        if not (0 <= top < top + height <= h and 0 <= left < left + width <= w):
            raise ValueError(
                f"a part must lie within the image of {h} x {w} pixels; got {height} x {width} "
                f"from row {top} and column {left} on."
            )
        if not self.scene.is_binned:
            raise ValueError(
                "a part needs a binned reading, whose scene states Panel.width, Sensor.pitch or "
                "Sensor.shrink; this shot's is full. Capture the image, and cut the photo."
            )

    @property
    def distortion(self) -> tuple[Tensor, Tensor] | None:
        """(k1, k2), (B,) each, if the plan has lens distortion, else None."""
        if "lens" not in self.plan:
            return None
        return self.lens.k1, self.lens.k2

    def matrix(self) -> Tensor:
        """Return the homography from image to ideal photo coordinates, (B, 3, 3) float64.
        Differentiable in every View field that the scene's pose reads."""
        return self._once("matrix", lambda: about_corners(self.homography, self.photo_size))

    def inverse_matrix(self) -> Tensor:
        """Return the inverse of `matrix`, from ideal photo to image coordinates, (B, 3, 3)."""
        return self._once("inverse", lambda: torch.linalg.inv(self.matrix()))

    def with_geometry_kept(self) -> Self:
        """Return the same shot, which computes its pose and frame once, for a single photo: they
        belong to the graph of its gradient."""
        shot = object.__new__(type(self))
        for name, value in vars(self).items():
            object.__setattr__(shot, name, value)
        object.__setattr__(shot, "_kept", {})
        return shot

    def sampled_pixels(self) -> tuple[lattice.SampledPixels, lattice.SampledPixels]:
        """Return which sensor rows and columns this photo reads."""
        every = self.plan.needs_every_pixel
        return sampled_rows_and_columns(self.scene, self.size, needs_every_pixel=every)

    def raw_shape(self) -> tuple[int, int, int, int]:
        """Return the shape of the raw reading and of the attacker's noise: four Bayer planes
        (B, 4, h / 2, w / 2), or three colours (B, 3, h, w); of a binned reading, four planes or
        three colours of the photo's size."""
        rows, cols = self.sampled_pixels()
        planes = sum(len(site.channels) for site in lattice.CFA[self.scene.filter_cell])
        step = lattice.pattern_period(self.scene.filter_cell)
        return len(self), planes, len(rows.index) // step, len(cols.index) // step

    @property
    def moves(self) -> bool:
        """Whether points move from image to photo; see `SceneRecord.moves`."""
        return self.scene.moves

    def to_photo(self, points: Tensor) -> Tensor:
        """Return where points (B, N, 2) of the image, x then y in pixels, lie in the photo's own
        frame, which is the image's for a registered scene. Integer points are rounded.

        Raises:
            TypeError: points that are not a tensor.
            ValueError: points of another shape, or of another number of images.
        """
        check_tensor("points", points)
        if points.ndim != 3 or points.shape[-1] != 2 or len(points) != len(self):
            raise ValueError(
                f"points must have the shape ({len(self)}, N, 2), x and y of N points in each "
                f"image of the shot; got {tuple(points.shape)}."
            )
        if not self.moves:
            return points
        shot = self.to(points.device)
        moved = points_in_photo(points.double(), shot.matrix(), shot.frame, shot.distortion)
        return as_dtype(moved, points.dtype)

    def to_photo_mask(self, mask: Tensor) -> Tensor:
        """Return a mask (B, C, H, W) of the image, of any dtype, in the photo's own frame: nearest
        pixel, 0 off the image.

        Raises:
            TypeError: a mask that is not a tensor.
            ValueError: a mask of another shape, or of another number or size of images.
        """
        check_tensor("a mask", mask)
        if mask.ndim != 4 or len(mask) != len(self) or tuple(mask.shape[-2:]) != self.size:
            raise ValueError(
                f"a mask must have the shape ({len(self)}, C, {self.size[0]}, {self.size[1]}) of "
                f"the shot's images; got {tuple(mask.shape)}."
            )
        if not self.moves:
            return mask
        shot = self.to(mask.device)
        return mask_in_photo(mask, shot.matrix(), shot.frame, shot.distortion)

    def host_numbers(self) -> np.ndarray:
        """Return a copy of the drawn numbers, (numbers, B) float64 in the order of `numbers`, by
        one transfer from a GPU."""
        return torch.stack(list(self._numbers.values())).detach().cpu().numpy()

    def to_dict(self) -> dict[str, Any]:
        """Return exact plain numbers and lists; `Shot.from_dict` is the inverse."""
        part = {}
        if self.part_of is not None:
            part["part_of"] = {name: list(pair) for name, pair in self.part_of._asdict().items()}
        return {
            "scene": self.scene.to_dict(),
            "size": list(self.size),
            **part,
            "seed": self.seed.tolist(),
            **by_part({name: values.tolist() for name, values in self.numbers().items()}),
        }
