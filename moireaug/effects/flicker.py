"""Flicker: a panel dimmed by pulse-width modulation, seen through a rolling shutter."""

from __future__ import annotations

import torch
from torch import Tensor


def flicker(rows: Tensor, frequency: Tensor, duty: Tensor, phase: Tensor, shutter: Tensor, readout: Tensor) -> Tensor:
    """How much light each row of the sensor gets of the panel's mean: (B, h), 1 on average.

    The panel is on for a share `duty` of each cycle, as bright as keeps its mean. Row r begins to expose at
    `r * readout` and does so for `shutter` seconds; the light of that time is a closed form. The bands have
    `frequency * readout` cycles from the first row to the last, and vanish where `shutter * frequency` is whole.

    Args:
        rows: (h,) or (B, h), 0 at the upper edge of the sensor and 1 at the lower one.
        frequency: (B,) hertz; 0 is a steady panel. duty: (B,) in (0, 1]. phase: (B,) cycles.
        shutter, readout: (B,) seconds, the first above 0.

    Differentiable in all of them, but for the corners where a pulse begins or ends.
    """
    frequency, duty, phase, shutter, readout = (t[:, None] for t in (frequency, duty, phase, shutter, readout))
    begin = phase + frequency * readout * rows
    cycles = frequency * shutter

    def lit(t: Tensor) -> Tensor:  # cycles of light from 0 to t
        whole = t.floor().detach()
        return whole * duty + torch.minimum(t - whole, duty)

    still = cycles < 1e-9
    share = (lit(begin + cycles) - lit(begin)) / (duty * torch.where(still, 1.0, cycles))
    return torch.where(still, torch.ones_like(share), share)
