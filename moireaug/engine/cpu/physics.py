"""The formulas of `moireaug.common.physics`, compiled by numba."""

from __future__ import annotations

import math

import numpy as np

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
    tone as tone_formulas,
)
from moireaug.common.physics.binding import bind
from moireaug.engine.cpu.compiling import inner


@inner
def _where(condition, a, b):
    return a if condition else b


@inner
def _shifted(x, bits):
    return np.uint32(x >> np.uint32(bits))


OPERATIONS = {
    "where": _where,
    "maximum": max,
    "minimum": min,
    "absolute": abs,
    "sqrt": math.sqrt,
    "ceil": math.ceil,
    "wrapped": np.uint32,  # numba would widen to 64 bits
    "shifted": _shifted,
    "ONE": np.float32(1),
    "TWO": np.float32(2),
    "SIX": np.float32(6),
}
footprint = bind(footprint_formulas, OPERATIONS, inner)
lens = bind(lens_formulas, OPERATIONS, inner)
panel = bind(panel_formulas, OPERATIONS, inner)
sensor = bind(sensor_formulas, OPERATIONS, inner)
tone = bind(tone_formulas, OPERATIONS, inner)
random_numbers = bind(random_numbers_formulas, OPERATIONS, inner, np.uint32)
