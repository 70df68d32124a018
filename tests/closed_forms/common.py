"""What the closed forms share: a flat screen's reading, and how near to its formula it must
come."""

import numpy as np
import torch

from moireaug import Panel, Sensor, expose
from moireaug.scene.layout import Layout

EVEN, COLOUR = Panel(layout="even"), Sensor(cfa="none")  # with these a photo is its image
CELL = Layout(((0, 0.0, 0.0, 0.5, 1.0), (1, 0.5, 0.0, 1.0, 0.4), (2, 1.25, 0.5, 1.75, 1.0)), (2, 1))
CLOSE = {torch.float64: 1e-11, torch.float32: 1e-6}


def sinc(x):
    return float(np.sinc(x))


def read(scene, size, dtype, level=1.0):
    """The raw reading of a flat screen (planes, h, w), in float64."""
    return expose(torch.full((1, 3, *size), level, dtype=dtype), scene.sample(1, size))[0].double()
