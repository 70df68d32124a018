"""Scenes small enough for many tests, one per frame, and a picture whose parts can be found again
in its photo."""

import dataclasses

import pytest
import torch

from moireaug import Develop, Lens, Panel, Scene, Sensor, View

REGISTERED = Scene(
    panel=Panel(scale=(0.8, 1.5)),
    view=View(yaw=(-20.0, 20.0), pitch=(-10.0, 10.0), roll=(-25.0, 25.0)),
    lens=Lens(k1=(-0.05, 0.05), blur=0.4),
    sensor=Sensor(gain=2.5, read_noise=0.01),
)
CAMERA = dataclasses.replace(REGISTERED, develop=Develop(registered=False))
# next to no moiré, no noise
CLEAR = dataclasses.replace(CAMERA, panel=Panel(scale=3.0), sensor=Sensor(scale=4.0))
SQUARE = (30.0, 10.0, 40.0, 18.0)  # x1, y1, x2, y2


@pytest.fixture
def registered():
    return REGISTERED


@pytest.fixture
def camera():
    return CAMERA


@pytest.fixture
def clear():
    return CLEAR


@pytest.fixture
def square():
    return SQUARE


@pytest.fixture
def marked():
    """(3, 48, 64): black but for one white rectangle, `SQUARE`."""
    image = torch.zeros(3, 48, 64)
    image[:, 10:18, 30:40] = 1
    return image


@pytest.fixture
def find():
    """Where the light is in a photo (C, H, W): its centroid (x, y), and the box of the brighter
    half."""

    def look(photo):
        light = photo.float().mean(0)
        y, x = (torch.arange(n) + 0.5 for n in light.shape)
        centroid = torch.stack([(light.sum(0) * x).sum(), (light.sum(1) * y).sum()]) / light.sum()
        on = light > light.max() / 2
        xs, ys = x[on.any(0)], y[on.any(1)]
        return centroid, torch.stack(
            [xs.min() - 0.5, ys.min() - 0.5, xs.max() + 0.5, ys.max() + 0.5]
        )

    return look
