"""The gradient in a shot's drawn numbers of what kernels compute: by central differences, two
results for each number that varies, whichever it is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from moireaug.camera.effects.light import light_of_rows
from moireaug.engine.kernel_stage import KernelStage
from moireaug.scene.by_name import limits, values_of, with_values
from moireaug.scene.fields import bounds
from moireaug.scene.geometry import grids
from moireaug.scene.geometry.frame import planar
from moireaug.scene.shot import ShotRecord

MAX_RELATIVE_STEP = 1e-3  # of a number, or of half its range if that is more
LEAST_SIZE = 0.1  # that a number counts as: float32 would not carry the change by a smaller step
MAX_FLICKER = 1e-4  # by which a step may change a row's light, relative to the mean
RELATIVE_PROBE = 1e-7  # of a number, to find in float64 how fast the panel moves
POINTS_PER_AXIS = 5  # of the image, at which that is found
FLICKER_ROWS = 33
MAX_PIXELS_AT_ONCE = 2**19  # of the values that are moved together
# How many times as exact as a photo's the results are of which differences are taken: what hardly
# shows in a photo adds to a gradient, if its phase turns fast. Kernels follow the first that they
# can.
EXACTNESS = (32, 4, 1)


def step_ends(shot: ShotRecord, names: Sequence[str], max_shift: float) -> Tensor:
    """Return the values above and below some drawn numbers between which to take differences,
    (2, names, B) float64. They are values that a scene may have: at a limit, one of the two is the
    number itself.

    Args:
        shot: on the CPU, and of numbers without a gradient.
        names: of the numbers, such as "view.yaw".
        max_shift: by which a step may move the panel over the sensor, in sensor pixels.
    """
    numbers, ranges = shot.numbers(), values_of(shot.scene)
    values = torch.stack([numbers[name] for name in names])
    half_widths = [(high - low) / 2 for low, high in (bounds(ranges[name]) for name in names)]
    size = torch.maximum(values.abs(), values.new_tensor(half_widths)[:, None])
    size = size.clamp(min=LEAST_SIZE)
    probe = RELATIVE_PROBE * size
    moved = moved_shot(shot, names, values + probe)
    motion = _motion(moved, shot, max_shift) - _motion(shot, shot, max_shift).repeat(len(names), 1)
    # points that the photo does not show may move as they like
    speed = motion.abs().nan_to_num(0.0, 0.0, 0.0).amax(1).view_as(probe) / probe
    step = torch.minimum(MAX_RELATIVE_STEP * size, 1 / speed)
    order = list(numbers)
    low, high = torch.from_numpy(limits(shot.scene))[:, [order.index(name) for name in names]]
    return torch.stack([(values + step).minimum(high), (values - step).maximum(low)])


def moved_shot(shot: ShotRecord, names: Sequence[str], values: Tensor) -> ShotRecord:
    """Return a shot of B images once for each of some names, which may repeat, each time with that
    number at its `values` (names, B): (names * B) images."""
    tables = {name: shot.numbers()[name].repeat(len(names), 1) for name in names}
    for row, name in enumerate(names):
        tables[name][row] = values[row]
    numbers = {name: table.flatten() for name, table in tables.items()}
    return with_values(shot.repeat(len(names)), numbers)


def _motion(shot: ShotRecord, start: ShotRecord, max_shift: float) -> Tensor:
    """Return what turns phases, (n * B, values) float64, in units of what a step may change it by:
    where points of the image lie on the sensor and on the panel, NaN of those that the photo does
    not show; and the light of rows that flicker.

    start: the shot of B images of which `shot` holds n.
    """
    frame, corner = shot.frame, shot.panel_corner[:, None, None]
    axes = [torch.linspace(0, side, POINTS_PER_AXIS, dtype=torch.float64) for side in shot.size]
    points = grids.grid(*axes).expand(len(shot), -1, -1, -1)
    centre = planar(frame.width / 2, frame.height / 2, points)
    seen = points + frame.image_corner(points)
    photo = grids.image_to_photo(seen, shot.matrix(), frame.size, shot.distortion) - centre
    photo = torch.where((photo.abs() <= centre + 1).all(-1, keepdim=True), photo, torch.nan)
    pitch = (start.sensor_scale / start.panel_scale).repeat(len(shot) // len(start))
    on_sensor = photo * shot.sensor_scale[:, None, None, None]
    on_panel = points * shot.panel_scale[:, None, None, None] + corner
    on_panel = on_panel * pitch[:, None, None, None]
    motion = [on_sensor.flatten(1) / max_shift, on_panel.flatten(1) / max_shift]
    if "flicker" in shot.plan:
        share = torch.linspace(0, 1, FLICKER_ROWS, dtype=torch.float64)
        rows = share * torch.as_tensor(frame.height, dtype=torch.float64).reshape(-1, 1)
        motion.append(light_of_rows(rows.expand(len(shot), -1), shot) / MAX_FLICKER)
    return torch.cat(motion, 1)


def gradients(stage: KernelStage, grad: Tensor, values: Tensor) -> list[Tensor | None]:
    """Return the gradient in each moved number of a stage's call, (B,) float64, or None where the
    stage does not read it.

    grad: that in the results (B, C, h, w) of values (B, C, H, W).
    """
    names, shot = stage.call.moved_numbers, stage.call.host_shot
    slopes = torch.zeros(len(names), len(shot), dtype=torch.float64)
    is_read = torch.zeros(len(names), dtype=torch.bool)
    pending = torch.arange(len(shot))
    for exactness in EXACTNESS:
        start = stage.lower(shot[pending], exactness)
        followed = torch.from_numpy(stage.can_follow(start))
        images, pending = pending[followed], pending[~followed]
        if len(images):
            if len(pending):
                start = stage.lower(shot[images], exactness)
            rows = images.to(values.device)
            part = ShotDifferences(stage, shot[images], exactness, start)
            slopes[:, images], is_read_here = part.slopes(grad[rows], values[rows])
            is_read |= is_read_here
        if not len(pending):
            break
    slopes = slopes.to(stage.shot.device)
    return [one if read else None for one, read in zip(slopes, is_read, strict=True)]


class ShotDifferences(NamedTuple):
    """How the results of a stage change with its shot.

    Args:
        shot: of b images, on the CPU and without a gradient.
        start: its records, by `exactness`.
    """

    stage: KernelStage
    shot: ShotRecord
    exactness: int
    start: Any

    def slopes(self, grad: Tensor, values: Tensor) -> tuple[Tensor, Tensor]:
        """Return the gradient in each moved number, (numbers, b) float64, and whether the stage
        reads it, (numbers,) bool; grad, values: as of `gradients`, of these images."""
        shot, stage, moved_numbers = self.shot, self.stage, self.stage.call.moved_numbers
        per_pass = max(1, MAX_PIXELS_AT_ONCE // (2 * values[:, 0].numel()))
        slopes, is_read = [], []
        for first in range(0, len(moved_numbers), per_pass):
            names = moved_numbers[first : first + per_pass]
            ends = step_ends(shot, names, stage.max_shift)
            moved = moved_shot(shot, (*names, *names), ends.flatten(0, 1))
            records = stage.lower(moved, self.exactness)
            is_changed = changed_rows(self.start, records)
            is_used = torch.from_numpy(is_changed & stage.can_follow(records)).view(ends.shape)
            change = self._changes(is_used, records, grad, values)
            # an end that kernels cannot follow, or that is the number itself, gives way to it
            at = torch.stack([shot.numbers()[name] for name in names])
            above, below = torch.where(is_used, ends, at)
            slopes.append(torch.where(above > below, change / (above - below), 0.0))
            is_read.append(torch.from_numpy(is_changed).view(ends.shape).any(2).any(0))
        return torch.cat(slopes), torch.cat(is_read)

    def _changes(self, is_used: Tensor, moved: Any, grad: Tensor, values: Tensor) -> Tensor:
        """Return the change of the results from below each number to above it, along their
        gradient: (names, b) float64.

        Args:
            is_used: (2, names, b), whether to take the end above and that below; else the number.
            moved: records of all ends.
        """
        changes = torch.zeros(is_used.shape[1:], dtype=torch.float64)
        number, image = is_used.any(0).nonzero(as_tuple=True)
        if len(image):
            _, names, count = is_used.shape
            # above all of them, and then below
            row = torch.cat([number * count + image, (names + number) * count + image])
            images, used = image.repeat(2), is_used.flatten()[row]
            records = mixed_rows((self.start, images.numpy()), (moved, row.numpy()), used.numpy())
            results, _ = self.stage.launch(values[images.to(values.device)], False, records)
            above, below = results.chunk(2)
            along = (above - below) * grad[image.to(values.device)]
            changes[number, image] = along.sum((1, 2, 3), dtype=torch.float64).cpu()
        return changes


def changed_rows(start: Any, moved: Any) -> np.ndarray:
    """Return which images have other records than those that they were moved from, (m * B,) bool.

    Args:
        start: records of B images.
        moved: records of the same images, m > 1 times.
    """
    changed: Any = False
    for a, b in zip(start, moved, strict=True):
        if isinstance(a, tuple):
            changed = changed | changed_rows(a, b)
        elif _has_rows(a, b):
            same = np.tile(a, (len(b) // len(a), *[1] * (a.ndim - 1)))
            changed = changed | (b != same).any(tuple(range(1, a.ndim)))
    return changed


def mixed_rows(
    start: tuple[Any, np.ndarray], moved: tuple[Any, np.ndarray], takes_moved: np.ndarray
) -> Any:
    """Return records of n images: each a row of one or of other records of the same scene and size.

    Args:
        start, moved: records, and which row of them to take for each image, (n,).
        takes_moved: (n,) bool.
    """
    mixed, (records, rows), (others, other_rows) = [], start, moved
    for a, b in zip(records, others, strict=True):
        if isinstance(a, tuple):
            a = mixed_rows((a, rows), (b, other_rows), takes_moved)
        elif _has_rows(a, b):
            mask = takes_moved.reshape(-1, *[1] * (a.ndim - 1))
            a = np.where(mask, b[other_rows], a[rows])
        mixed.append(a)
    return type(records)(*mixed) if hasattr(records, "_fields") else tuple(mixed)


def _has_rows(a: Any, b: Any) -> bool:
    """Return whether a record's value is an array with a row for each image, from its values of
    two numbers of images."""
    return isinstance(a, np.ndarray) and a.shape != b.shape
