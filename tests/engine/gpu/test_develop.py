"""The GPU's kernels develop as the reference does, and their gradients are right."""

import dataclasses

import numpy as np
import pytest
import torch

pytest.importorskip("triton")
from moireaug import Develop, Panel, Scene, Sensor, View
from moireaug.camera import pipeline
from moireaug.engine.execution import execution_of
from moireaug.engine.gpu import develop as gpu
from moireaug.engine.gpu import physics, tile
from moireaug.engine.lower.development import lower_development
from moireaug.scene.by_name import with_values
from tests.engine.test_develop import FILTERED

PANEL, SENSOR = Panel(width=60.0), Sensor(pitch=2.0, gain=2.0)
SCENES = {
    "codes": Scene(panel=PANEL, sensor=SENSOR, develop=Develop(linear_light=False)),
    "light, no colour filters": Scene(
        panel=PANEL,
        sensor=dataclasses.replace(SENSOR, cfa="none"),
        develop=Develop(linear_light=True),
    ),
    "everything": Scene(
        panel=PANEL,
        sensor=dataclasses.replace(SENSOR, crosstalk=0.15),
        develop=Develop(linear_light=True, **FILTERED),
    ),
}
SEVERAL_TILES = Scene(
    panel=PANEL,
    view=View(yaw=(5.0, 20.0)),
    sensor=Sensor(pitch=2.0, cfa="none"),
    develop=Develop(chroma_blur=(0.1, 0.3), sharpen=0.5, sharpen_radius=0.3, registered=False),
)


def shot_and_reading(scene, size, n=1):
    """A shot, and a reading that leaves [0, 1], and is exactly on the bounds, too."""
    shot = scene.sample(n, size, torch.Generator().manual_seed(1))
    raw = torch.rand(shot.raw_shape(), generator=torch.Generator().manual_seed(2)) * 1.3 - 0.1
    raw[..., :3] = raw[..., :3].round()
    return shot, raw


def assert_equal(scene, size, n=1):
    shot, raw = shot_and_reading(scene, size, n)
    effects = execution_of(shot.scene, shot.plan).engine_effects
    development = lower_development(shot, effects)
    precise = raw.double().requires_grad_()
    expected = pipeline.apply(effects, precise, shot)
    ahead = torch.randn(expected.shape, generator=torch.Generator().manual_seed(3))
    (slope,) = torch.autograd.grad(expected, precise, ahead.double())
    assert (gpu.develop(raw, development) - expected).abs().max() < 1e-5
    grad = gpu.develop_back(ahead, raw, development)
    assert (grad - slope).norm() <= 1e-4 * slope.norm()


@pytest.mark.parametrize("name", SCENES)
def test_equals_the_reference_and_its_gradient(name):
    assert_equal(SCENES[name], (7, 10))


def test_one_pixel():
    assert_equal(SCENES["light, no colour filters"], (1, 1))


def test_several_images_and_tiles(monkeypatch):
    monkeypatch.setattr(tile, "TILE", (4, 8))
    assert_equal(SEVERAL_TILES, (3, 10), n=2)


def test_the_code_of_full_light_has_a_digit_to_spare():
    assert np.float32(physics.CODE_GAIN) < np.float32(1.055)


def test_another_development_is_not_equal():
    scene = SCENES["everything"]
    shot, raw = shot_and_reading(scene, (7, 10))
    other, _ = shot_and_reading(with_values(scene, {"develop.chroma_blur": 3.0}), (7, 10))
    effects = execution_of(other.scene, other.plan).engine_effects
    photo = gpu.develop(raw, lower_development(other, effects))
    assert (photo - pipeline.develop(raw.double(), shot)).abs().max() > 0.01
