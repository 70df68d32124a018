"""The formulas of `physics` over tensors, for the reference."""

from __future__ import annotations

import math
from typing import Any

import torch

from moireaug.common.numeric import sinc
from moireaug.common.physics.binding import bind


def _maximum(x: Any, least: Any) -> Any:
    if not isinstance(x, torch.Tensor):
        return max(x, least)
    return torch.maximum(x, least) if isinstance(least, torch.Tensor) else x.clamp(min=least)


def _minimum(x: Any, most: Any) -> Any:
    return torch.minimum(x, most) if isinstance(most, torch.Tensor) else x.clamp(max=most)


def _shifted(x: torch.Tensor, bits: int) -> torch.Tensor:
    """Shift int32 bits right, without their sign."""
    return (x >> bits).bitwise_and_(2 ** (32 - bits) - 1)


def _signed(x: float) -> float:
    """Return the int32 with the same bits."""
    return x - 2**32 if x >= 2**31 else x


OPERATIONS = {
    "where": torch.where,
    "maximum": _maximum,
    "minimum": _minimum,
    "absolute": torch.abs,
    "sqrt": torch.sqrt,
    "ceil": torch.ceil,
    "power": torch.pow,
    "exp": torch.exp,
    "normal_cdf": torch.special.ndtr,
    "sinc": sinc,
    "cos_pi": lambda x: torch.cos(math.pi * x),
    "wrapped": lambda x: x,
    "shifted": _shifted,
}
aliases = bind("aliases", OPERATIONS)
clipping = bind("clipping", OPERATIONS)
footprint = bind("footprint", OPERATIONS)
lens = bind("lens", OPERATIONS)
optics = bind("optics", OPERATIONS)
panel = bind("panel", OPERATIONS)
sensor = bind("sensor", OPERATIONS)
srgb = bind("srgb", OPERATIONS)
tone = bind("tone", OPERATIONS)
random_numbers = bind("random_numbers", OPERATIONS, constant=_signed)
