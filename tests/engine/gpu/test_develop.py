"""The GPU's kernels develop as the reference and the CPU's do, and their gradients are right."""

import dataclasses

import pytest
import torch

pytest.importorskip("triton")
from moireaug import Develop, Lens, Scene, Sensor, View, develop, pipeline
from moireaug.engine.gpu import develop as gpu
from moireaug.engine.gpu import develop_back, tile
from moireaug.engine.lower.development import lower_development
from moireaug.engine.program import program_of

TONED = Develop(
    linear_light=True,
    red=1.3,
    blue=0.8,
    saturation=(0.6, 1.5),
    shoulder=(0.0, 1.5),
    contrast=(-0.5, 0.8),
    brighten=0.05,
)
FILTERED = dataclasses.replace(
    TONED, chroma_blur=(0.0, 1.5), sharpen=(0.2, 1.0), sharpen_radius=0.8
)
TURNED = View(yaw=20.0, pitch=-8.0, roll=10.0)
SCENES = {
    "malvar, one and a half": Scene(
        sensor=Sensor(scale=1.5, bits=6, crosstalk=0.15),
        develop=dataclasses.replace(TONED, demosaic="malvar"),
    ),
    "point": Scene(
        sensor=Sensor(scale=8.0), develop=Develop(linear_light=True, resize="point", blue=0.7)
    ),
    "no colour filters": Scene(
        sensor=Sensor(scale=1.5, cfa="none", gain=2.0),
        develop=dataclasses.replace(TONED, resize="antialias"),
    ),
    "binned": Scene.preset("screen_photo"),
    "everything": Scene(
        view=TURNED,
        lens=Lens(k1=0.05, k2=-0.02),
        sensor=Sensor(scale=2.0, gain=2.0),
        develop=FILTERED,
    ),
}


@pytest.fixture(autouse=True)
def large_tiles(monkeypatch):
    """Tiles as large as a test's photos: the interpreter takes as long for large ones."""
    monkeypatch.setitem(tile.TILE, "ROWS", 32)
    monkeypatch.setitem(tile.TILE, "COLS", 64)


def reading_of(shot):
    """A reading that leaves [0, 1], and is exactly on the bounds, too."""
    raw = torch.rand(shot.raw_shape(), generator=torch.Generator().manual_seed(2)) * 1.3 - 0.1
    raw[..., :3] = raw[..., :3].round()
    return raw


def shot_of(scene, size, n=1):
    return scene.sample(n, size, torch.Generator().manual_seed(1))


def assert_equal(scene, size, n=1):
    shot = shot_of(scene, size, n)
    raw = reading_of(shot)
    development = lower_development(shot)
    effects = program_of(shot.scene, shot.plan).engine_effects
    precise = raw.double().requires_grad_()
    expected = pipeline.apply(effects, precise, shot)
    ahead = torch.randn(expected.shape, generator=torch.Generator().manual_seed(3))
    (slope,) = torch.autograd.grad(expected, precise, ahead.double())
    photo = gpu.develop(raw, development)
    assert (photo - expected).abs().max() < 1e-5
    if effects == shot.plan.developing:
        assert (photo - develop(raw, shot)).abs().max() < 1e-5
    grad = develop_back.develop_back(ahead, raw, development)
    assert (grad - slope).norm() <= 1e-4 * slope.norm()


@pytest.mark.parametrize("name", SCENES)
def test_equals_the_reference_and_its_gradient(name):
    assert_equal(SCENES[name], (9, 14))


def test_several_images_and_tiles(monkeypatch):
    monkeypatch.setitem(tile.TILE, "ROWS", 4)
    monkeypatch.setitem(tile.TILE, "COLS", 8)
    narrow = Develop(chroma_blur=(0.1, 0.3), sharpen=0.5, sharpen_radius=0.3)
    scene = Scene(view=View(yaw=(5.0, 20.0)), sensor=Sensor(cfa="none"), develop=narrow)
    assert_equal(scene, (5, 10), n=2)


def test_one_pixel():
    assert_equal(SCENES["everything"], (1, 1))


@pytest.mark.parametrize(
    ("name", "field", "value"),
    [
        ("malvar, one and a half", "demosaic", "bilinear"),
        ("everything", "chroma_blur", 3.0),
        ("everything", "registered", False),
    ],
)
def test_another_development_is_not_equal(name, field, value):
    scene = SCENES[name]
    changed = dataclasses.replace(
        scene, develop=dataclasses.replace(scene.develop, **{field: value})
    )
    shot, other = shot_of(scene, (9, 14)), shot_of(changed, (9, 14))
    raw = reading_of(shot)
    photo = gpu.develop(raw, lower_development(other))
    assert (photo - pipeline.develop(raw.double(), shot)).abs().max() > 0.01
