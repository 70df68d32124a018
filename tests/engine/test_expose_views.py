"""Steep views: the engine follows those that fit, and leaves the others to the reference."""

import pytest
import torch

from moireaug import Lens, Panel, Scene, Sensor, View, expose
from moireaug.engine.cpu import run
from moireaug.engine.lower.exposure import lower_exposure
from moireaug.scene.by_name import with_values
from tests.engine.readings import assert_equal, readings

SOFT, TWICE = Lens(blur=(0.2, 0.4)), Sensor(scale=2.0)
STEEP = {
    "oblique": (
        Scene(panel=Panel(scale=1.1), view=View(yaw=35.0, fov=40.0), lens=SOFT, sensor=TWICE),
        (40, 40),
    ),
    "barrel": (Scene(lens=Lens(k1=0.1, k2=0.02, blur=0.3), sensor=TWICE), (40, 40)),
    "pincushion": (Scene(lens=Lens(k1=-0.08, blur=0.3), sensor=TWICE), (31, 50)),
}


@pytest.mark.parametrize("name", STEEP)
def test_steep_views_that_fit_are_equal(name):
    scene, size = STEEP[name]
    shot = scene.sample(1, size, torch.Generator().manual_seed(3))
    assert run.fits(*lower_exposure(shot, decoded=False)).tolist() == [True]
    assert_equal(*readings(scene, size, n=1))


def test_an_image_is_read_the_same_beside_one_of_the_horizon():
    scene = Scene(view=View(yaw=(0.0, 85.0), fov=60.0), lens=SOFT, sensor=TWICE)
    shot = scene.sample(3, (40, 40), torch.Generator().manual_seed(0))
    yaw = torch.tensor([5.0, 85.0, -5.0], dtype=torch.float64)
    shot = with_values(shot, {"view.yaw": yaw})
    images = torch.rand(3, 3, 40, 40, generator=torch.Generator().manual_seed(1))
    assert run.fits(*lower_exposure(shot, decoded=False)).tolist() == [True, False, True]
    alone = [expose(images[i : i + 1], shot[i : i + 1]) for i in range(3)]
    assert torch.equal(expose(images, shot), torch.cat(alone))
