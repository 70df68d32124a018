"""The camera as a layer: fresh photos in training, the same in evaluation, gradients, corners."""

import copy
import io
import pickle

import pytest
import torch
from torch import nn
from torch.utils.checkpoint import checkpoint

from moireaug import Scene, View, capture
from moireaug.attacks.model import repeats_answers
from moireaug.defenses import Compose, Defended
from moireaug.evaluation.classifiers import averaging_classifier
from moireaug.nn import ScreenCamera
from moireaug.synthesis.twins import moire_codes

SIZE = (24, 32)


@pytest.fixture
def images():
    return torch.rand(4, 3, *SIZE, generator=torch.Generator().manual_seed(0))


@pytest.fixture(params=[0.0, 2.0], ids=["exact", "jittered"])
def camera(request):
    return ScreenCamera("screen_photo", shrink=(1, 3), jitter=request.param)


def test_training_draws_afresh_from_the_global_generator(camera, images):
    torch.manual_seed(3)
    first, second = camera(images), camera(images)
    torch.manual_seed(3)
    assert first.shape == images.shape and first.dtype == images.dtype
    assert torch.equal(camera(images), first) and not torch.equal(first, second)
    same = camera(images[:1].expand(4, -1, -1, -1))
    assert not torch.equal(same[0], same[1])  # a shot of its own for each image


def test_evaluation_takes_the_same_photos_in_each_pass(camera, images):
    state = torch.get_rng_state()
    passes = []
    for _ in range(2):
        camera.eval()
        passes.append([camera(images), camera(images)])
    assert torch.equal(torch.get_rng_state(), state)
    assert torch.equal(passes[0][0], passes[1][0]) and torch.equal(passes[0][1], passes[1][1])
    assert not torch.equal(passes[0][0], passes[0][1])
    other = ScreenCamera("screen_photo", shrink=(1, 3), jitter=camera.jitter, seed=1).eval()
    assert not torch.equal(other(images), passes[0][0])


def test_before_a_model_it_is_a_random_defence_in_evaluation_too(camera, images):
    camera.eval()
    assert Compose((camera,)).randomised and averaging_classifier("camera", camera).draws == 20
    for model in (Defended(nn.Flatten(), camera).eval(), Defended(nn.Flatten(), camera).train()):
        assert model.randomised and not repeats_answers(model, images).any()


def test_a_draw_replays_and_has_a_twin(camera, images):
    draw = camera.draw(images)
    photos = camera(images, draw)
    assert torch.equal(photos, camera(images, draw))
    assert draw.shot.scene.is_crop and (draw.corner_errors is None) == (not camera.jitter)
    twins = camera.twin(images, draw)
    assert 0.5 < moire_codes(photos, twins).mean() < 30
    if not camera.jitter:
        assert torch.equal(photos, capture(images, draw.shot))
        noise = torch.full(draw.shot.raw_shape(), 0.05)
        assert torch.equal(camera(images, draw, noise), capture(images, draw.shot, noise))


def test_a_mixture_has_twins_too(images):
    camera = ScreenCamera(["screen_photo", "phone_at_laptop"], shrink=2.0, jitter=1.0)
    torch.manual_seed(0)
    draw = camera.draw(images)
    assert len(draw.shot.by_scene()) == 2
    assert torch.equal(camera(images, draw), camera(images, draw))
    assert moire_codes(camera(images, draw), camera.twin(images, draw)).min() > 0


def test_gradients_reach_the_images(camera, images):
    images = images.double()[:2, :, :8, :8].clone().requires_grad_()
    draw = camera.draw(images)
    weight = torch.rand(2, 3, 8, 8, dtype=torch.float64)
    (slope,) = torch.autograd.grad((camera(images, draw) * weight).sum(), images)
    step = 1e-3 * torch.randn(images.shape, dtype=torch.float64)
    images = images.detach()
    ends = [(camera((images + sign * step).clamp(0, 1), draw) * weight).sum() for sign in (1, -1)]
    assert float(ends[0] - ends[1]) / 2 == pytest.approx(float((slope * step).sum()), rel=0.05)


def test_corners_move_by_what_was_drawn(images):
    """A closed form: all four corners found one pixel too far right shift the photo left by one."""
    camera = ScreenCamera(Scene(view=View(roll=(-3.0, 3.0))), jitter=1.0)
    draw = camera.draw(images)
    assert draw.corner_errors.shape == (4, 4, 2) and draw.corner_errors.abs().max() <= 1
    photos = camera(images, draw._replace(corner_errors=None))
    shifted = camera(images, draw._replace(corner_errors=torch.tensor([1.0, 0.0]).expand(4, 4, 2)))
    assert torch.allclose(shifted[..., :-1], photos[..., 1:], atol=1e-4)
    assert torch.allclose(shifted[..., -1], photos[..., -1], atol=1e-4)  # no more is there
    still = camera(images, draw._replace(corner_errors=torch.zeros(4, 4, 2)))
    assert torch.allclose(still, photos, atol=1e-4)


def test_in_a_network_it_is_copied_saved_checkpointed_and_computed_in_halves(camera, images):
    network = nn.Sequential(nn.Conv2d(3, 3, 1), nn.Sigmoid(), camera, nn.Conv2d(3, 2, 1))
    assert not any("camera" in name or name.startswith("2.") for name in network.state_dict())
    camera.eval()
    want = camera(images)
    camera.eval()
    for other in (copy.deepcopy(camera), pickle.loads(pickle.dumps(camera))):
        assert torch.equal(other(images), want)
    file = io.BytesIO()
    torch.save(network.state_dict(), file)
    file.seek(0)
    network.load_state_dict(torch.load(file))
    network.train()
    torch.manual_seed(1)
    plain = network(images)
    torch.manual_seed(1)
    again = checkpoint(network, images, use_reentrant=False)
    assert torch.equal(plain, again)
    gradients = torch.autograd.grad(again.sum(), list(network.parameters()))
    wanted = torch.autograd.grad(plain.sum(), list(network.parameters()))
    assert all(torch.allclose(a, b) for a, b in zip(gradients, wanted, strict=True))
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert torch.isfinite(network(images)).all()
    assert camera(images.bfloat16()).dtype == torch.bfloat16


def test_no_images_and_single_pixels(camera):
    assert camera(torch.rand(0, 3, 8, 8)).shape == (0, 3, 8, 8)
    for size in ((1, 1), (1, 5), (4, 1)):
        assert torch.isfinite(camera(torch.rand(2, 3, *size))).all()


def test_what_cannot_be_gets_a_sentence():
    images, shot = torch.rand(1, 3, 8, 8), ScreenCamera().scene.sample(1, (8, 8))
    for photograph in (ScreenCamera(), ScreenCamera().twin):
        with pytest.raises(TypeError, match=r"got a Shot. Of a shot, make ScreenDraw\(shot\)"):
            photograph(images, shot)
    with pytest.raises(TypeError, match="seed must be a whole number"):
        ScreenCamera(seed=1.5)
    with pytest.raises(ValueError, match=r"jitter must be .* at least 0"):
        ScreenCamera(jitter=-1.0)
    with pytest.raises(ValueError, match="stay in the camera's frame"):
        ScreenCamera("paper", jitter=1.0)
    with pytest.raises(TypeError, match=r"For a probability, pass p=0\.5"):
        ScreenCamera(0.5)
    assert "jitter=2" in repr(ScreenCamera(jitter=2.0))
