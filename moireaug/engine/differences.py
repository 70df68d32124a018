"""The gradient in a shot's drawn numbers of what kernels compute: by central differences, two
results for each number that varies, whichever it is."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from moireaug.engine.lower.rows import changed_rows, rows_of
from moireaug.engine.shot_steps import moved_shot, step_ends
from moireaug.engine.stage import KernelStage
from moireaug.scene.shot import ShotRecord

MAX_PIXELS_AT_ONCE = 2**19  # of the values that are moved together
# How many times as exact as a photo's the results are of which differences are taken: what hardly
# shows in a photo adds to a gradient, if its phase turns fast. Kernels follow the first that they
# can.
EXACTNESS = (32, 4, 1)


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
        count = is_used.shape[-1]
        # of both ends: a row of the results, the moved ones first
        used = is_used.flatten().nonzero().flatten()
        still = (is_used[0] ^ is_used[1]).any(0).nonzero().flatten()
        place = torch.zeros_like(is_used, dtype=torch.int64)
        order = torch.zeros(count, dtype=torch.int64)
        order[still] = len(used) + torch.arange(len(still))
        place[:] = order
        place.view(-1)[used] = torch.arange(len(used))
        results = []
        for rows, records, others in ((used, moved, self.start), (still, self.start, moved)):
            if len(rows):
                images = (rows % count).to(values.device)
                taken = rows_of(records, others, rows.numpy())
                results.append(self.stage.launch(values[images], False, taken)[0])
        changes = torch.zeros(is_used.shape[1:], dtype=torch.float64)
        if results:
            number, image = is_used.any(0).nonzero(as_tuple=True)
            above, below = (ends[number, image].to(values.device) for ends in place)
            both = torch.cat(results)
            along = (both[above] - both[below]) * grad[image.to(values.device)]
            changes[number, image] = along.sum((1, 2, 3), dtype=torch.float64).cpu()
        return changes
