"""The point exposure's kernel equals the reference."""

import dataclasses

import pytest
import torch

from moireaug import Develop, Panel, Scene, Sensor, View, expose
from moireaug.camera import pipeline
from moireaug.engine import execution

POINT = Sensor(scale=3.0, exposure="point")
TURNED = View(yaw=(-20.0, 20.0), pitch=(-10.0, 10.0), roll=(-20.0, 20.0))
SCENES = {
    "paper": Scene.preset("paper"),
    "paper_code": Scene.preset("paper_code"),
    "led": Scene(panel=Panel(scale=2.0, layout="led", lit=(0.5, 0.9)), view=TURNED, sensor=POINT),
    "no colour filters": Scene(view=TURNED, sensor=dataclasses.replace(POINT, cfa="none")),
    "light": Scene(view=TURNED, sensor=POINT, develop=Develop(linear_light=True)),
    "glare": Scene(panel=Panel(glare=0.2, glare_x=0.3, glare_y=-0.4), view=TURNED, sensor=POINT),
    "crosstalk": Scene(view=TURNED, sensor=dataclasses.replace(POINT, crosstalk=(0.1, 0.3))),
    "everything": Scene(
        panel=Panel(black=0.1, glare=0.2, glare_x=0.3, scale=1.5, layout="pentile"),
        view=TURNED,
        sensor=dataclasses.replace(POINT, cfa="none", crosstalk=0.2, read_noise=0.01),
        develop=Develop(linear_light=True),
    ),
    "camera's frame": Scene(view=TURNED, sensor=POINT, develop=Develop(registered=False)),
    "coarse": Scene(panel=Panel(scale=0.3, layout="pentile"), view=TURNED, sensor=POINT),
    "coarse and fine, camera's frame": Scene(
        panel=Panel(scale=(0.3, 1.7)), view=TURNED, sensor=POINT, develop=Develop(registered=False)
    ),
}


@pytest.mark.parametrize("size", [(23, 31), (1, 1), (1, 8), (9, 1)])
@pytest.mark.parametrize("name", SCENES)
def test_equals_the_reference(name, size):
    shot = SCENES[name].sample(3, size, torch.Generator().manual_seed(2))
    images = torch.rand(3, 3, *size, generator=torch.Generator().manual_seed(3))
    assert not execution.call_of(shot, None, images).execution.why_not_expose
    got, expected = expose(images, shot).double(), pipeline.expose(images.double(), shot)
    different = (got - expected).abs() > 1e-5
    # a pixel that falls on the border between two may be rounded to either
    assert different.sum() <= different.numel() * 1e-3
    assert (got - expected).abs().mean() < 1e-4
