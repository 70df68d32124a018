"""Full readings on a GPU, and their gradients in the picture, equal the reference in float64, on
random pictures."""

import dataclasses

import pytest
import torch

pytest.importorskip("triton")
from moireaug import Develop, Lens, Panel, Scene, Sensor, View
from moireaug.camera import pipeline
from moireaug.engine.gpu import full, spectral
from moireaug.engine.lower.exposure import lower_exposure
from tests.engine.readings import assert_equal
from tests.engine.scenes import DELTA, TURNED

SCENES = {
    "everything": Scene(
        panel=Panel(black=0.02, glare=0.1, glare_x=0.3, scale=0.9),
        view=TURNED,
        lens=Lens(k1=0.03, k2=-0.02, blur=0.4, motion_x=0.3, olpf=0.3, vignetting=0.3),
        sensor=Sensor(scale=2.0, gain=1.5, crosstalk=0.15, read_noise=0.01, shot_noise=0.02),
        develop=Develop(linear_light=True),
    ),
    "flickering pentile": Scene(
        panel=Panel(layout="pentile", pwm=(200.0, 500.0), scale=(0.7, 0.9)), view=TURNED,
        lens=Lens(blur=0.3),
        sensor=Sensor(scale=2.0, shutter=0.002, readout=0.03),
    ),
    "delta without colour filters, camera's frame": Scene(
        panel=Panel(layout=DELTA), view=TURNED, lens=Lens(blur=0.6),
        sensor=Sensor(scale=1.0, cfa="none"), develop=Develop(registered=False),
    ),
    "more cells in view than taps, camera's frame": Scene(
        panel=Panel(scale=4.0), view=View(yaw=20.0, roll=5.0, zoom=0.8),
        sensor=Sensor(exposure="mean", cfa="none"), develop=Develop(registered=False),
    ),
    "past the horizon of a tiny screen": Scene(
        panel=Panel(scale=2), view=View(yaw=89, pitch=89, zoom=1e-3),
        develop=Develop(registered=False),
    ),
    "fine and sharp": Scene(panel=Panel(scale=2.5), sensor=Sensor(scale=3.0)),
    "paper": Scene.preset("paper"),
    "paper_code": Scene.preset("paper_code"),
    "point, everything": Scene(
        panel=Panel(black=0.1, glare=0.2, glare_x=0.3, layout="pentile", pwm=300.0),
        view=TURNED,
        sensor=Sensor(
            scale=2.0, exposure="point", cfa="none", crosstalk=0.2, read_noise=0.01, gain=1.5,
            shutter=0.002, readout=0.03,
        ),
        develop=Develop(linear_light=True),
    ),
    "point, coarse and fine, camera's frame": Scene(
        panel=Panel(scale=(0.3, 1.3)), view=TURNED, sensor=Sensor(scale=2.0, exposure="point"),
        develop=Develop(registered=False),
    ),
}  # fmt: skip


def shot_and_images(name, size):
    n = 2 if name.startswith(("flickering", "p")) else 1
    shot = SCENES[name].sample(n, size, torch.Generator().manual_seed(5))
    return shot, torch.rand(n, 3, *size, generator=torch.Generator().manual_seed(6))


ONE_PIXEL = "more cells in view than taps, camera's frame", "paper"


@pytest.mark.parametrize("name", SCENES)
def test_equals_the_reference(name):
    shot, images = shot_and_images(name, (1, 1) if name in ONE_PIXEL else (4, 6))
    raw = full.expose(images, *lower_exposure(shot, decoded=False))
    assert_equal(raw.double(), pipeline.expose(images.double(), shot))


@pytest.mark.parametrize(
    "name",
    [
        "everything",
        "delta without colour filters, camera's frame",
        "point, everything",
        "point, coarse and fine, camera's frame",
    ],
)
def test_gradient_equals_the_reference(name):
    shot, images = shot_and_images(name, (3, 5))
    exact = images.double().requires_grad_()
    raw = pipeline.expose(exact, shot)
    slopes = torch.randn(raw.shape, generator=torch.Generator().manual_seed(7))
    (expected,) = torch.autograd.grad(raw, exact, slopes.double())
    grad = full.expose_back(slopes, images, *lower_exposure(shot, decoded=False))
    assert (grad - expected).norm() < 1e-4 * expected.norm()


def test_a_reading_does_not_depend_on_the_rest_of_the_batch():
    """Its neighbour's gain shows harmonics that are too faint in its own."""
    scene = Scene(lens=Lens(blur=0.5), sensor=Sensor(scale=2.0, gain=(1.0, 100.0), cfa="none"))
    shot, images = scene.sample(2, (3, 4)), torch.rand(2, 3, 3, 4)
    gain = torch.tensor([1.0, 100.0], dtype=torch.float64)
    shot = dataclasses.replace(shot, sensor=dataclasses.replace(shot.sensor, gain=gain))
    readings = []
    for n in (1, 2):
        exposure, view = lower_exposure(shot[:n], decoded=False)
        view.coefficients[:, :, 1:] = exposure.budget.harmonic_amplitude / 2
        readings.append(full.expose(images[:n], exposure, view)[0])
    assert torch.equal(*readings)


def test_pixels_of_a_fine_panel_lie_in_fewer_pixels_of_the_picture():
    spans = []
    for scale in (1.5, 3.5):
        shot = Scene(panel=Panel(scale=scale), sensor=Sensor(scale=8.0)).sample(1, (4, 5))
        spans.append(spectral.span_of(lower_exposure(shot, decoded=False)[0]))
    assert spans[1] < spans[0]


def test_a_panel_of_another_pitch_is_not_equal():
    shot, images = shot_and_images("fine and sharp", (4, 6))
    panel = dataclasses.replace(shot.panel, scale=shot.panel.scale * 1.002)
    other = dataclasses.replace(shot, panel=panel)
    raw = full.expose(images, *lower_exposure(other, decoded=False))
    with pytest.raises(AssertionError):
        assert_equal(raw.double(), pipeline.expose(images.double(), shot))
