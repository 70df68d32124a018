"""Bins that are the image's own pixels: the engine reads by a stencil what the reference does."""

import pytest
import torch

from moireaug import Develop, Lens, Panel, Scene, Sensor, View, expose
from moireaug.camera import pipeline
from moireaug.engine import execution
from moireaug.engine.cpu import run
from moireaug.engine.lower.exposure import lower_exposure
from moireaug.engine.lower.exposure_records import Camera
from tests.engine.readings import assert_equal

TURNED = View(yaw=(-30.0, 30.0), pitch=(-20.0, 20.0), roll=(-15.0, 15.0))
BLURRED = Lens(blur=3.0, motion_x=(-2.0, 2.0), motion_y=(-2.0, 2.0))
BENT = Lens(blur=(0.3, 1.2), k1=(-0.05, 0.05), olpf=(0.0, 0.5))
COARSE = Panel(width=(60.0, 70.0), lit=0.7)
SCENES = {
    "blurred": (3, Scene(panel=COARSE, view=TURNED, lens=BLURRED, sensor=Sensor(pitch=2.0))),
    "moved": (3, Scene(panel=COARSE, lens=Lens(motion_x=4.0), sensor=Sensor(pitch=(1.5, 2.5)))),
    "bent": (2, Scene(panel=COARSE, view=TURNED, lens=BENT, sensor=Sensor(pitch=2.0))),
    "interpolated": (
        3,
        Scene(
            panel=Panel(scale=(1.2, 1.6), lit_x=0.5), view=TURNED, lens=BENT,
            sensor=Sensor(scale=2.0, reading="binned"),
        ),
    ),
    "sharp": (1, Scene(panel=Panel(width=900.0), view=TURNED, sensor=Sensor(pitch=2.0))),
}  # fmt: skip


def of(scene, *size):
    """A shot that the engine reads by a stencil, and how far to each side."""
    shot = scene.sample(2, size, torch.Generator().manual_seed(5))
    exposure, _ = lower_exposure(shot, decoded=False)
    assert scene.is_rectified
    assert (exposure.cameras[:, Camera._fields.index("alpha")] == 1).all()
    return shot, exposure.cell.radius


def assert_reads_alike(images, shot):
    assert not execution.call_of(shot, None, images).execution.why_not_expose
    assert_equal(expose(images, shot).double(), pipeline.expose(images.double(), shot))


def noise(*size):
    return torch.rand(2, 3, *size, generator=torch.Generator().manual_seed(6))


@pytest.mark.parametrize(("radius", "scene"), SCENES.values(), ids=SCENES)
def test_a_stencil_reads_as_the_reference_does(radius, scene):
    shot, reach = of(scene, 37, 52)
    assert reach == radius
    assert_reads_alike(noise(37, 52), shot)


@pytest.mark.parametrize("size", [(1, 1), (1, 40), (40, 1), (2, 3)], ids=str)
@pytest.mark.parametrize("scene", ["blurred", "sharp"])
def test_pictures_of_few_pixels(scene, size):
    shot, _ = of(SCENES[scene][1], *size)
    assert_reads_alike(noise(*size), shot)


@pytest.mark.parametrize("scene", ["blurred", "sharp"])
def test_bytes_are_read_by_a_stencil_too(scene):
    shot, _ = of(SCENES[scene][1], 30, 33)
    codes = (noise(30, 33) * 255).round().byte()
    got, _ = run.launch_expose(codes, False, *lower_exposure(shot, decoded=False))
    assert_equal(got.double(), pipeline.expose(codes.double() / 255, shot))


@pytest.mark.parametrize("linear", [False, True])
def test_a_flat_picture_stays_flat(linear):
    """Weights sum to 1 everywhere, though the spread changes over the photo."""
    scene = Scene(
        panel=Panel(width=60.0, layout="even"), view=View(yaw=40.0), lens=BLURRED,
        sensor=Sensor(pitch=2.0), develop=Develop(linear_light=linear),
    )  # fmt: skip
    shot, _ = of(scene, 30, 40)
    read = expose(torch.full((2, 3, 30, 40), 0.6), shot)
    assert read.std() < 1e-6 and read.mean() > 0.1
