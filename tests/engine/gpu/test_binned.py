"""Binned readings by the GPU's kernels, and their gradient in the picture, equal the reference's in
float64."""

import dataclasses

import pytest
import torch

pytest.importorskip("triton")

from moireaug import Develop, Lens, Panel, Scene, Sensor, View
from moireaug.camera import pipeline
from moireaug.engine.gpu import binned
from moireaug.engine.lower.exposure import lower_exposure
from tests.engine.readings import assert_equal

SIZE = (10, 13)
TURNED = View(yaw=24.0, pitch=-12.0, roll=8.0, fov=40.0)
LENS = Lens(k1=0.04, k2=-0.02, blur=0.5, olpf=0.5, motion_x=0.3, motion_y=-0.2, vignetting=0.3)
PANEL = Panel(width=30.0, lit=0.6, black=0.05, glare=0.1, glare_x=0.3, glare_y=-0.2, pwm=200.0)
SENSOR = Sensor(pitch=2.2, gain=1.2, crosstalk=0.2, read_noise=0.02, shot_noise=0.03)
SCENES = {
    "everything": Scene(
        panel=PANEL, view=TURNED, lens=LENS,
        sensor=dataclasses.replace(SENSOR, shutter=0.002, readout=0.0003),
        develop=Develop(linear_light=True, resize="antialias"),
    ),
    "no colour filters": Scene(
        panel=Panel(width=24.0, layout="chevron"), view=TURNED, lens=Lens(blur=0.3),
        sensor=Sensor(pitch=1.3, cfa="none"),
    ),
    "panel finer than the picture": Scene(
        panel=Panel(scale=1.3, lit=0.5), view=View(roll=4.0), lens=Lens(blur=0.3),
        sensor=Sensor(scale=2.0, reading="binned"),
    ),
    "panel coarser than the picture, in the camera's frame": Scene(
        panel=Panel(width=(5.0, 9.0)), view=TURNED, lens=LENS, sensor=Sensor(pitch=1.3, gain=1.2),
        develop=Develop(registered=False),
    ),
    "crop, shrunk without a prefilter": Scene(
        panel=dataclasses.replace(PANEL, width=0.0), view=TURNED, lens=LENS,
        sensor=dataclasses.replace(SENSOR, shrink=1.4, shutter=0.002, readout=0.0003),
        develop=Develop(resize="point"),
    ),
    "thing of known size, in the camera's frame": Scene(
        panel=Panel(width=9.0, layout="led", lit=0.5), view=TURNED, lens=Lens(blur=0.4),
        sensor=Sensor(shrink=2.0), develop=Develop(registered=False),
    ),
    "no harmonic": Scene(panel=PANEL, sensor=dataclasses.replace(SENSOR, exposure="mean")),
    "phone_at_phone": Scene.preset("phone_at_phone"),
}  # fmt: skip


def shot_and_picture(scene, n=1):
    g = torch.Generator().manual_seed(3)
    return scene.sample(n, SIZE, g), torch.rand(n, 3, *SIZE, generator=g)


def both_readings(shot, picture):
    """The kernels' readings, and the reference's."""
    expected = pipeline.expose(picture.double(), shot)
    return binned.expose(picture, *lower_exposure(shot, decoded=False)), expected


@pytest.mark.parametrize("name", SCENES)
def test_equals_the_reference(name):
    assert_equal(*both_readings(*shot_and_picture(SCENES[name])))


@pytest.mark.parametrize(
    ("name", "most"),
    [
        ("everything", 1e-4),
        ("panel coarser than the picture, in the camera's frame", 1e-4),
        ("crop, shrunk without a prefilter", 5e-4),
    ],
)
def test_the_gradient_in_the_picture(name, most):
    shot, picture = shot_and_picture(SCENES[name], n=2 if name.startswith("panel") else 1)
    exact = picture.double().requires_grad_()
    expected = pipeline.expose(exact, shot)
    grad = torch.randn(expected.shape, generator=torch.Generator().manual_seed(5))
    (expected,) = torch.autograd.grad(expected, exact, grad.double())
    grad = binned.expose_back(grad, picture, *lower_exposure(shot, decoded=False))
    assert (grad - expected).norm() < most * expected.norm()


def test_another_pitch_is_not_equal():
    shot, picture = shot_and_picture(SCENES["panel finer than the picture"])
    panel = dataclasses.replace(shot.panel, scale=shot.panel.scale * 1.001)
    other = dataclasses.replace(shot, panel=panel)
    got = binned.expose(picture, *lower_exposure(other, decoded=False))
    with pytest.raises(AssertionError):
        assert_equal(got, pipeline.expose(picture.double(), shot))


def test_a_view_of_the_horizon_does_not_fit():
    view = View(yaw=(0.0, 85.0), fov=60.0, fit=False)
    scene = Scene(panel=Panel(width=60.0), view=view, sensor=Sensor(pitch=2.0))
    shot = scene.sample(2, SIZE)
    yaw = torch.tensor([5.0, 85.0], dtype=torch.float64)
    shot = dataclasses.replace(shot, view=dataclasses.replace(shot.view, yaw=yaw))
    assert binned.fits(*lower_exposure(shot, decoded=False)).tolist() == [True, False]


def test_terms_are_chosen_once_for_each_batch(monkeypatch):
    choose, batches = binned.beat_terms, []

    def count(*records):
        batches.append(records)
        return choose(*records)

    monkeypatch.setattr(binned, "beat_terms", count)
    shot, picture = shot_and_picture(SCENES["no harmonic"])
    for records in [lower_exposure(shot, decoded=False) for _ in range(2)]:
        binned.fits(*records)
        binned.expose(picture, *records)
    assert len(batches) == 2
