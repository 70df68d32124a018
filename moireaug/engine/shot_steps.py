"""How far a drawn number is moved for a difference of readings or photos: so little that no phase
of the pattern turns far, and so much that float32 carries the change."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from moireaug.camera.effects.flicker import light_of_rows
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
    low, high = torch.from_numpy(limits())[:, [order.index(name) for name in names]]
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
