"""The gradient in a shot's drawn numbers of what kernels compute: by central differences, two
results for each number that varies, whichever it is."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from moireaug.engine.lower.rows import changed_rows, rows_of
from moireaug.engine.shot_steps import moved_shot, step_ends
from moireaug.scene.shot import ShotRecord

MAX_PIXELS_AT_ONCE = 2**19  # of the values that are moved together
# How many times as exact as a photo's the results are of which differences are taken: what hardly
# shows in a photo adds to a gradient, if its phase turns fast. Kernels follow the first that they
# can.
EXACTNESS = (32, 4, 1)


class ShotDifferences(NamedTuple):
    """How the results of a stage change with its shot.

    Args:
        shot: of B images, on the CPU.
        names: of its numbers in which a gradient is asked for.
        max_shift: by which a step may move the panel over the sensor, in sensor pixels.
        lower: returns the records of a shot, by an exactness; see `lower.rows`.
        fits: returns whether kernels can follow each image's records, (B,) bool.
        launch: returns the results of values, by their records.
    """

    shot: ShotRecord
    names: tuple[str, ...]
    max_shift: float
    lower: Callable[[ShotRecord, int], Any]
    fits: Callable[[Any], np.ndarray]
    launch: Callable[[Tensor, Any], Tensor]

    @property
    def numbers(self) -> list[Tensor]:
        """The numbers in which a gradient is asked for, (B,) each."""
        numbers = self.shot.numbers()
        return [numbers[name] for name in self.names]

    def gradients(self, grad: Tensor, values: Tensor) -> list[Tensor | None]:
        """Return the gradient in each number, (B,) float64, or None where the stage does not read
        it; grad: that in the results (B, C, h, w) of values (B, C, H, W)."""
        shot = without_gradient(self.shot)
        slopes = torch.zeros(len(self.names), len(shot), dtype=torch.float64)
        is_read = torch.zeros(len(self.names), dtype=torch.bool)
        pending = torch.arange(len(shot))
        for exactness in EXACTNESS:
            start = self.lower(shot[pending], exactness)
            fitting = torch.from_numpy(self.fits(start))
            images, pending = pending[fitting], pending[~fitting]
            if len(images):
                if len(pending):
                    start = self.lower(shot[images], exactness)
                rows = images.to(values.device)
                given = shot[images], exactness, start, grad[rows], values[rows]
                slopes[:, images], is_read_here = self._slopes(*given)
                is_read |= is_read_here
            if not len(pending):
                break
        return [one if read else None for one, read in zip(slopes, is_read, strict=True)]

    def _slopes(
        self, shot: ShotRecord, exactness: int, start: Any, grad: Tensor, values: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return the gradient in each number, (names, b) float64, of b images, and whether the
        stage reads it, (names,) bool.

        Args:
            shot: of the images, without a gradient.
            start: its records, by `exactness`.
            grad, values: as of `gradients`, of these images.
        """
        per_pass = max(1, MAX_PIXELS_AT_ONCE // (2 * values[:, 0].numel()))
        slopes, is_read = [], []
        for first in range(0, len(self.names), per_pass):
            names = self.names[first : first + per_pass]
            ends = step_ends(shot, names, self.max_shift)
            moved = self.lower(moved_shot(shot, (*names, *names), ends.flatten(0, 1)), exactness)
            is_changed = changed_rows(start, moved)
            is_used = torch.from_numpy(is_changed & self.fits(moved)).view(ends.shape)
            change = self._changes(is_used, start, moved, grad, values)
            # an end that kernels cannot follow, or that is the number itself, gives way to it
            at = torch.stack([shot.numbers()[name] for name in names])
            above, below = torch.where(is_used, ends, at)
            slopes.append(torch.where(above > below, change / (above - below), 0.0))
            is_read.append(torch.from_numpy(is_changed).view(ends.shape).any(2).any(0))
        return torch.cat(slopes), torch.cat(is_read)

    def _changes(
        self, is_used: Tensor, start: Any, moved: Any, grad: Tensor, values: Tensor
    ) -> Tensor:
        """Return the change of the results from below each number to above it, along their
        gradient: (names, b) float64.

        Args:
            is_used: (2, names, b), whether to take the end above and that below; else the number.
            start, moved: records of the b images, and of all ends.
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
        for rows, records, others in ((used, moved, start), (still, start, moved)):
            if len(rows):
                images = (rows % count).to(values.device)
                taken = rows_of(records, others, rows.numpy())
                results.append(self.launch(values[images], taken))
        changes = torch.zeros(is_used.shape[1:], dtype=torch.float64)
        if results:
            number, image = is_used.any(0).nonzero(as_tuple=True)
            above, below = (ends[number, image].to(values.device) for ends in place)
            both = torch.cat(results)
            along = (both[above] - both[below]) * grad[image.to(values.device)]
            changes[number, image] = along.sum((1, 2, 3), dtype=torch.float64).cpu()
        return changes


def without_gradient(shot: ShotRecord) -> ShotRecord:
    """Return a shot of the same numbers, of which none requires a gradient."""
    return shot.map_rows(torch.detach) if shot.requires_grad else shot
