"""Whole photos by the GPU's kernels, chosen from the table of backends as a GPU's are."""

import pytest
import torch

pytest.importorskip("triton")

from moireaug import Scene, capture, engine
from moireaug.engine import backends
from moireaug.engine.gpu import run
from tests.engine.readings import assert_equal

SIZE = (9, 12)
SCENES = {"bins": Scene.preset("screen_photo"), "crops": Scene.preset("phone_at_laptop")}
DEVICE = "cuda" if torch.cuda.is_available() else "cpu"


@pytest.fixture(autouse=True)
def _only_the_gpus_kernels(monkeypatch):
    gpu = backends.backend_of("cuda")
    monkeypatch.setattr(backends, "BACKENDS", (gpu._replace(device_type=DEVICE),))


def shot_and_images(name):
    shot = SCENES[name].sample(1, SIZE, torch.Generator().manual_seed(3))
    images = torch.rand(1, 3, *SIZE, generator=torch.Generator().manual_seed(4))
    return shot, images.to(DEVICE)


def photo_and_gradient(images, shot):
    shown = images.clone().requires_grad_()
    photo = capture(shown, shot)
    direction = torch.randn(photo.shape, generator=torch.Generator().manual_seed(7))
    (grad,) = torch.autograd.grad((photo * direction.to(photo)).sum(), shown)
    return photo.detach().double(), grad.double()


@pytest.mark.parametrize("name", SCENES)
def test_photos_and_their_gradients_are_the_references(name):
    shot, images = shot_and_images(name)
    photo, grad = photo_and_gradient(images, shot)
    expected, slope = photo_and_gradient(images.double(), shot)
    assert_equal(photo, expected)
    assert (grad - slope).norm() < 1e-3 * slope.norm()


def test_a_deterministic_gradient_is_the_references(monkeypatch):
    shot, images = shot_and_images("bins")
    _, expected = photo_and_gradient(images.double(), shot)
    monkeypatch.setattr(run, "launch_expose_back", lambda *_, **__: pytest.fail("kernels run"))
    torch.use_deterministic_algorithms(True)
    try:
        _, grad = photo_and_gradient(images, shot)
    finally:
        torch.use_deterministic_algorithms(False)
    assert (grad - expected).norm() < 1e-3 * expected.norm()


def test_what_a_gpu_runs_is_explained(monkeypatch):
    monkeypatch.undo()
    lines = engine.explain(SCENES["bins"]).splitlines()
    assert [line.split()[2] for line in lines] == ["cpu"] * 3 + ["cuda"] * 3
    assert all("Triton kernels" in line for line in lines[3:])


def test_full_readings_are_the_references(monkeypatch):
    monkeypatch.undo()
    for line in engine.explain(Scene.preset("paper_code")).splitlines()[3:]:
        assert "reference: Triton kernels take binned readings alone" in line
