"""The formulas of `physics` over tensors, for the reference."""

from __future__ import annotations

from typing import Any

import torch

from moireaug.common.numeric import sinc
from moireaug.common.physics import (
    aliases as aliases_formulas,
)
from moireaug.common.physics import (
    footprint as footprint_formulas,
)
from moireaug.common.physics import (
    lens as lens_formulas,
)
from moireaug.common.physics import (
    panel as panel_formulas,
)
from moireaug.common.physics import (
    random_numbers as random_numbers_formulas,
)
from moireaug.common.physics import (
    sensor as sensor_formulas,
)
from moireaug.common.physics import (
    srgb as srgb_formulas,
)
from moireaug.common.physics import (
    tone as tone_formulas,
)
from moireaug.common.physics.binding import bind


def _maximum(x: Any, least: Any) -> Any:
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
    "sinc": sinc,
    "wrapped": lambda x: x,
    "shifted": _shifted,
}
aliases = bind(aliases_formulas, OPERATIONS)
footprint = bind(footprint_formulas, OPERATIONS)
lens = bind(lens_formulas, OPERATIONS)
panel = bind(panel_formulas, OPERATIONS)
sensor = bind(sensor_formulas, OPERATIONS)
srgb = bind(srgb_formulas, OPERATIONS)
tone = bind(tone_formulas, OPERATIONS)
random_numbers = bind(random_numbers_formulas, OPERATIONS, constant=_signed)
