"""The gradient of the engine's readings in the image equals the reference's in float64."""

import dataclasses

import pytest
import torch

from moireaug import Develop, Lens, Panel, Scene, Sensor, View, capture, expose
from moireaug.camera import pipeline
from moireaug.camera.exposure.bin_geometry import pixels_on_photo
from moireaug.engine import execution, reference
from moireaug.engine.cpu import run
from moireaug.engine.lower.budget import ErrorBudget
from moireaug.engine.lower.exposure import lower_exposure
from moireaug.scene.presets import PRESETS
from tests.engine import scenes, test_point

SIZE = (13, 16)
# of the gradient's norm: by default, and where kernels leave next to nothing out
MAX_ERROR, MAX_TIGHT_ERROR = 1e-3, 3e-4
FULL = (
    "bent", "coarse", "three", "no colour filters", "camera's frame", "photon noise",
    "flicker and glare", "black level, light", "black level, prefilter that varies",
)  # fmt: skip
POINT = ("everything", "led", "coarse and fine, camera's frame")
BRIGHT = Sensor(pitch=2.1, gain=2.5, read_noise=0.02, shot_noise=0.05, crosstalk=0.1)
SCENES = {
    **{name: scenes.SCENES[name] for name in FULL},
    **{f"{name}, point": test_point.SCENES[name] for name in POINT},
    **{name: Scene.preset(name) for name in PRESETS},
    "mean": Scene(view=View(roll=5.0), sensor=Sensor(scale=2.0, exposure="mean")),
    "bins that saturate": Scene(
        panel=Panel(width=700.0, pwm=200.0, black=0.05, glare=0.1), view=View(yaw=20.0, roll=5.0),
        lens=Lens(vignetting=0.3, blur=0.4, k1=0.03), develop=Develop(linear_light=True),
        sensor=dataclasses.replace(BRIGHT, shutter=0.002, readout=0.001),
    ),
    "few and many panel pixels in bins, camera's frame": Scene(
        panel=Panel(width=(5.0, 40.0)), view=View(yaw=20.0, roll=5.0),
        sensor=dataclasses.replace(BRIGHT, cfa="none"), develop=Develop(registered=False),
    ),
}  # fmt: skip


def shot_and_images(name, size=SIZE):
    shot = SCENES[name].sample(2, size, torch.Generator().manual_seed(3))
    return shot, torch.rand(2, 3, *size, generator=torch.Generator().manual_seed(4))


def gradient(function, images, shot):
    """Return the gradient of one number of readings or photos, along a fixed random direction, and
    these."""
    images = images.clone().requires_grad_()
    raw = function(images, shot)
    direction = torch.randn(raw.shape, generator=torch.Generator().manual_seed(7))
    if shot.scene.is_rectified:  # beside the photo, beats are less exact
        direction = direction * pixels_on_photo(shot)[1][:, None]
    return torch.autograd.grad((raw * direction).sum(), images)[0].double(), raw.detach()


def error(got, expected):
    return (got - expected).norm() / expected.norm()


@pytest.mark.parametrize("name", SCENES)
def test_equals_the_references_and_changes_no_reading(name, monkeypatch):
    shot, images = shot_and_images(name)
    assert not execution.call_of(shot, None, images).execution.why_not_expose
    expected, _ = gradient(pipeline.expose, images.double(), shot)
    got, raw = gradient(expose, images, shot)
    assert torch.equal(raw, expose(images, shot))
    assert error(got, expected) < MAX_ERROR
    tight = ErrorBudget.of(0)
    monkeypatch.setattr(ErrorBudget, "of", lambda tolerance, exactness=1: tight)
    assert error(gradient(expose, images, shot)[0], expected) < MAX_TIGHT_ERROR


def test_another_record_has_another_gradient(monkeypatch):
    shot, images = shot_and_images("bent")
    expected, _ = gradient(expose, images, shot)

    def moved(*given, **options):
        exposure, view = lower_exposure(*given, **options)
        return exposure._replace(cameras=exposure.cameras * (1 + 1e-3)), view

    monkeypatch.setattr("moireaug.engine.lower.exposure.lower_exposure", moved)
    assert error(gradient(expose, images, shot)[0], expected) > 2 * MAX_ERROR


@pytest.mark.filterwarnings("ignore:Input #0 requires gradient:UserWarning")  # in float32
@pytest.mark.parametrize("name", ["bent", "coarse", "mean", "led, point"])
def test_is_the_slope_of_the_readings(name):
    shot, images = shot_and_images(name, (4, 5))
    images.requires_grad_()
    # readings are linear in these images: a long step has no error but rounding
    assert torch.autograd.gradcheck(
        lambda images: expose(images, shot), images, eps=0.1, atol=1e-3, rtol=1e-3, fast_mode=True
    )


def test_photos_have_the_gradient_of_the_references():
    shot, images = shot_and_images("screen_photo")
    got, photo = gradient(capture, images, shot)
    assert torch.equal(photo, capture(images, shot))
    assert error(got, gradient(capture, images.double(), shot)[0]) < MAX_ERROR


def test_derivatives_of_the_gradient_are_the_references():
    shot, images = shot_and_images("photon noise", (4, 5))
    found = []
    for dtype in (torch.float32, torch.float64):
        shown = images.to(dtype).requires_grad_()
        (once,) = torch.autograd.grad(expose(shown, shot).square().sum(), shown, create_graph=True)
        found.append(torch.autograd.grad(once.square().sum(), shown)[0].double())
    assert error(*found) < MAX_ERROR


def test_a_batch_of_gradients_is_that_of_each():
    shot, images = shot_and_images("led, point", (4, 5))
    images.requires_grad_()
    raw = expose(images, shot)
    grads = torch.randn(3, *raw.shape)
    together = torch.autograd.grad(raw, images, grads, is_grads_batched=True, retain_graph=True)[0]
    for grad, got in zip(grads, together, strict=True):
        (expected,) = torch.autograd.grad(raw, images, grad, retain_graph=True)
        assert error(got, expected) < MAX_ERROR


def test_images_that_the_reference_exposes_keep_their_gradient():
    scene = Scene(view=View(yaw=(0, 89), pitch=(0, 89), fov=60))
    shot = scene.sample(16, (32, 32), torch.Generator().manual_seed(0))
    images = torch.rand(16, 3, 32, 32, generator=torch.Generator().manual_seed(1))
    with reference():
        expected, _ = gradient(expose, images, shot)
    got, _ = gradient(expose, images, shot)
    fits = run.fits(*lower_exposure(shot, decoded=False))
    assert fits.any() and not fits.all()
    assert error(got, expected) < MAX_ERROR


def test_threads_change_no_bit():
    shot, images = shot_and_images("screen_photo", (70, 20))
    found = []
    for count in (1, 2):
        torch.set_num_threads(count)
        found.append(gradient(expose, images, shot)[0])
    assert torch.equal(*found)
