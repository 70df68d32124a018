"""The GPU's kernels develop as the reference does, and their gradients are right."""

import numpy as np
import pytest
import torch

pytest.importorskip("triton")
from moireaug import Develop, Scene, Sensor, View
from moireaug.camera import pipeline
from moireaug.engine.execution import execution_of
from moireaug.engine.gpu import develop as gpu
from moireaug.engine.gpu import tile, tone
from moireaug.engine.lower.development import lower_development
from moireaug.scene.by_name import with_values
from tests.engine.test_develop import SCENES

SEVERAL_TILES = Scene(
    view=View(yaw=(5.0, 20.0)),
    sensor=Sensor(cfa="none"),
    develop=Develop(chroma_blur=(0.1, 0.3), sharpen=0.5, sharpen_radius=0.3),
)


def shot_and_reading(scene, size, n=1):
    """A shot, and a reading that leaves [0, 1], and is exactly on the bounds, too."""
    shot = scene.sample(n, size, torch.Generator().manual_seed(1))
    raw = torch.rand(shot.raw_shape(), generator=torch.Generator().manual_seed(2)) * 1.3 - 0.1
    raw[..., :3] = raw[..., :3].round()
    return shot, raw


def assert_equal(scene, size, n=1):
    shot, raw = shot_and_reading(scene, size, n)
    development = lower_development(shot)
    precise = raw.double().requires_grad_()
    effects = execution_of(shot.scene, shot.plan).engine_effects
    expected = pipeline.apply(effects, precise, shot)
    ahead = torch.randn(expected.shape, generator=torch.Generator().manual_seed(3))
    (slope,) = torch.autograd.grad(expected, precise, ahead.double())
    assert (gpu.develop(raw, development) - expected).abs().max() < 1e-5
    grad = gpu.develop_back(ahead, raw, development)
    assert (grad - slope).norm() <= 1e-4 * slope.norm()


@pytest.mark.parametrize("name", ["no colour filters, antialias", "malvar", "everything"])
def test_equals_the_reference_and_its_gradient(name):
    bits = {"sensor.bits": 6 if name == "everything" else None}
    assert_equal(with_values(SCENES[name], bits), (7, 10))


def test_one_pixel():
    assert_equal(SCENES["no colour filters, antialias"], (1, 1))


def test_several_images_and_tiles(monkeypatch):
    monkeypatch.setattr(tile, "TILE", (4, 8))
    assert_equal(SEVERAL_TILES, (3, 10), n=2)


def test_the_code_of_full_light_has_a_digit_to_spare():
    assert np.float32(tone.SRGB_GAIN.value) < np.float32(1.055)


def test_another_development_is_not_equal():
    scene = SCENES["everything"]
    shot, raw = shot_and_reading(scene, (7, 10))
    other, _ = shot_and_reading(with_values(scene, {"develop.chroma_blur": 3.0}), (7, 10))
    photo = gpu.develop(raw, lower_development(other))
    assert (photo - pipeline.develop(raw.double(), shot)).abs().max() > 0.01
