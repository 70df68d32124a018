"""Which photos the engine takes, and what it leaves to the reference."""

import contextlib
import dataclasses
import logging
from unittest.mock import Mock

import numpy as np
import pytest
import torch
from torch.autograd import forward_ad

from moireaug import Develop, Scene, Sensor, View, capture, develop, expose
from moireaug.camera import pipeline
from moireaug.camera.effects.base import Effect, called
from moireaug.common.numeric import repeat_edges
from moireaug.engine import backends, execution, explain, kernel_stage, reference, stages
from moireaug.engine.backends import BACKENDS
from moireaug.mixtures import as_scenes
from moireaug.scene.by_name import with_values
from moireaug.scene.presets import MIXTURES

SHOT = Scene.preset("screen_photo").sample(4, (16, 20), torch.Generator().manual_seed(0))
IMAGES = torch.rand(4, 3, 16, 20, generator=torch.Generator().manual_seed(1))
FULL = Scene(view=View(roll=3.0), sensor=Sensor(scale=2.0))


def test_what_kernels_are_compiled_for_is_tried_apart(monkeypatch):
    variants = []
    kernels = Mock(fits=lambda exposure, view: np.ones(len(exposure.cameras), bool))
    monkeypatch.setattr(kernel_stage, "kernels_of", lambda backend: kernels)
    monkeypatch.setattr(
        kernel_stage,
        "matches_reference",
        lambda stage, light, back: variants.append(stage.variant()),
    )
    changes = [
        {}, {"sensor.cfa": "none"}, {"sensor.reading": "binned"}, {"sensor.read_noise": 0.01},
        {"sensor.read_noise": 0.01, "sensor.gain": 2.0}, {"develop.registered": False},
        {"lens.k1": 0.1},
    ]  # fmt: skip
    scenes = [with_values(FULL, change) for change in changes]
    for scene in scenes:
        expose(IMAGES, scene.sample(4, (16, 20)))
    assert len(set(variants)) == len(scenes)


def test_photos_whose_views_kernels_cannot_follow_are_counted_once(monkeypatch):
    monkeypatch.setattr(stages, "_reported", set())
    said = []
    monkeypatch.setattr(logging.getLogger("moireaug"), "warning", said.append)
    scene = with_values(FULL, {"view.yaw": (0.0, 89.0)})
    shot = with_values(scene.sample(3, (16, 20)), {"view.yaw": torch.tensor([0.0, 89.0, 89.0])})
    for _ in range(2):
        expose(IMAGES[:3], shot)
    assert len(said) == 1 and "the views of 2 of these 3 photos" in said[0]
    expose(IMAGES, FULL.sample(4, (16, 20)))
    assert len(said) == 1


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_a_reading_that_is_not_finite_is_left_to_the_reference_alone(value):
    raw = expose(IMAGES, SHOT)
    expected = develop(raw, SHOT)
    raw[1, 2, 3, 4] = value
    with reference():
        expected[1] = develop(raw[1:2], SHOT[1:2])[0]
    assert torch.equal(develop(raw, SHOT).nan_to_num(-1), expected.nan_to_num(-1))


def test_the_reference_is_forced_until_the_last_block_is_left():
    first, second = reference(), reference()  # as two threads open and leave them
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)
    assert explain(SHOT.scene).count("the engine is turned off") == 3 * len(BACKENDS)
    second.__exit__(None, None, None)
    assert "the engine is turned off" not in explain(SHOT.scene)


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("denoise", None, "in float32"),
        ("denoise", "bilateral", "in float32; reference from 'denoise' on"),
        ("jpeg", 90.0, "in float32; reference from 'jpeg' on"),
    ],
)
def test_what_the_engine_leaves_to_the_reference_is_said(field, value, said):
    scene = with_values(FULL, {f"develop.{field}": value})
    exposes, develops = explain(scene).splitlines()[:2]
    assert exposes.endswith("on cpu    numba kernels, in float32")
    assert develops.endswith(said)


class Halved(Effect):
    """Somebody's own effect, for which there are no kernels."""

    name = "halved"

    def verdict(self, scene):
        return called("always")

    def __call__(self, values, shot):
        return values / 2


class Smoothed(Halved):
    """Another, which reads a pixel's neighbours."""

    needs_every_pixel = True

    def __call__(self, values, shot):
        return torch.nn.functional.avg_pool2d(repeat_edges(values, 1, 1, 1, 1), 3, 1)


POINT = Scene(sensor=Sensor(scale=9.0), develop=Develop(resize="point"))
DETAIL = {"develop.chroma_blur": 1.0, "develop.sharpen": 0.5}
SCENES = {
    "binned": Scene.preset("screen_photo"),
    "binned, detail": with_values(Scene.preset("screen_photo"), DETAIL),
    "full": FULL,
    "full, detail": with_values(FULL, DETAIL),
    "point": POINT,
}


@pytest.mark.parametrize("own", [Halved(), Smoothed()], ids=["halved", "smoothed"])
@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("place", range(len(pipeline.DEVELOP) + 1))
def test_an_effect_without_a_kernel_may_be_anywhere_in_development(place, name, own, monkeypatch):
    others = pipeline.DEVELOP
    monkeypatch.setattr(pipeline, "DEVELOP", (*others[:place], own, *others[place:]))
    scene = dataclasses.replace(SCENES[name])  # whose plan is of these effects
    shot = scene.sample(2, (16, 20), torch.Generator().manual_seed(0))
    before = [effect.name for effect in others[:place]]
    found = execution.execution_of(scene, shot.plan)
    assert bool(found.why_not_develop) == ("clip" not in before)
    assert set(found.engine_effects) <= set(before)
    photo = capture(IMAGES[:2], shot)
    with reference():
        torch.testing.assert_close(photo, capture(IMAGES[:2], shot), atol=1 / 512, rtol=0)


@pytest.mark.parametrize("first", [True, False])
def test_an_effect_without_a_kernel_is_not_dropped_from_the_exposure(first, monkeypatch):
    own, others = (Halved(),), pipeline.EXPOSE
    monkeypatch.setattr(pipeline, "EXPOSE", own + others if first else others + own)
    scene = dataclasses.replace(FULL)  # whose plan is of these effects
    assert "'halved'" in explain(scene)
    shot = scene.sample(4, (16, 20), torch.Generator().manual_seed(0))
    photo = capture(IMAGES, shot)
    with reference():
        torch.testing.assert_close(photo, capture(IMAGES, shot), atol=1 / 512, rtol=0)


def test_an_effect_that_nobody_knows_is_not_skipped():
    with pytest.raises(KeyError, match="vigneting"):
        pipeline.apply(("decode", "vigneting"), IMAGES, SHOT)


def test_a_reading_of_nan_has_no_jpeg():
    scene = with_values(SHOT.scene, {"develop.jpeg": 90.0})
    shot = scene.sample(len(IMAGES), IMAGES.shape[-2:])
    raw = expose(IMAGES, shot)
    raw[1, 2, 3, 4] = float("nan")
    with pytest.raises(ValueError, match="NaN, which has no 8-bit code"):
        develop(raw, shot)


@pytest.mark.filterwarnings("ignore:.torch.jit.script:FutureWarning")  # PyTorch's own call
@pytest.mark.parametrize("field", ["view.yaw", "sensor.gain", "develop.red"])
def test_forward_derivatives_in_a_shot_are_not_lost(field):
    value, found = SHOT.numbers()[field], []
    for dtype in (torch.float32, torch.float64):
        with forward_ad.dual_level():
            dual = forward_ad.make_dual(value, torch.ones_like(value))
            photo = capture(IMAGES.to(dtype), with_values(SHOT, {field: dual}))
            found.append(forward_ad.unpack_dual(photo).tangent)
    single, double = found
    assert (single - double).norm() < 0.01 * double.norm()


def test_a_parameter_is_captured_as_its_values_are():
    patch = torch.nn.Parameter(IMAGES.clone())
    with torch.no_grad():
        assert torch.equal(capture(patch, SHOT), capture(IMAGES, SHOT))


def test_the_defaults_of_torch_change_nothing():
    scene = Scene(view=View(yaw=(0, 89), pitch=(0, 89), fov=60))  # the reference takes some rows
    shot = scene.sample(16, (32, 32), torch.Generator().manual_seed(0))
    images = torch.rand(16, 3, 32, 32)
    expected = capture(images, shot)
    torch.set_default_dtype(torch.float64)
    try:
        assert torch.equal(capture(images, shot), expected)
    finally:
        torch.set_default_dtype(torch.float32)
    with torch.device("meta"):  # as where it is a GPU
        again = SHOT.scene.sample(4, (16, 20), torch.Generator("cpu").manual_seed(0))
        assert torch.equal(capture(IMAGES, again), capture(IMAGES, SHOT))


@pytest.mark.filterwarnings("ignore:.torch.jit.script:FutureWarning")  # PyTorch's own call
def test_a_tangent_is_not_lost():
    with forward_ad.dual_level():
        dual = forward_ad.make_dual(IMAGES, torch.ones_like(IMAGES))
        tangent = forward_ad.unpack_dual(capture(dual, SHOT)).tangent
    assert tangent.shape == IMAGES.shape and tangent.any()


def test_the_environment_turns_the_engine_off(monkeypatch):
    for value in ("off", "OFF", "0", "false", "", "on"):
        monkeypatch.setenv(backends.ENGINE_VARIABLE, value)
        off = value not in ("", "on")
        assert ("turned off" in execution.explain(Scene.preset("screen_photo"))) == off
    monkeypatch.setenv(backends.ENGINE_VARIABLE, "of")
    with pytest.raises(ValueError, match="MOIREAUG_ENGINE must be 'off', or unset; got 'of'"):
        Scene.preset("screen_photo").capture(torch.rand(1, 3, 8, 8))


def test_on_a_gpu_the_photo_of_a_reading_that_is_not_finite_is_nan():
    """Nothing is asked of the values, which would wait for the GPU."""
    raw = expose(IMAGES, SHOT)
    photo = develop(raw, SHOT).requires_grad_()
    raw[1, 2, 3, 4] = float("inf")
    marked = stages.nan_where(~stages.finite_images(raw), photo)
    assert marked[1].isnan().all() and torch.equal(marked[[0, 2, 3]], photo[[0, 2, 3]])
    marked[0].sum().backward()
    assert photo.grad[0].eq(1).all() and not photo.grad[1:].any()


@pytest.mark.parametrize("shrink", [None, 4.0])
def test_kernels_follow_every_screen_at_1024_px(monkeypatch, shrink):
    """The reference takes minutes for such a photo. An LED board has thousands of beats."""
    followed = {}

    def stop(stage, records):
        followed[stage.shot.scene] = stage.kernels.fits(*records)
        raise InterruptedError

    monkeypatch.setattr(stages.Exposing, "can_follow", stop)
    torch.manual_seed(0)
    for name in MIXTURES["anywhere"]:
        scene = as_scenes(name, shrink)
        shot = scene.sample(4, (1024, 1024))
        with contextlib.suppress(InterruptedError):
            capture(torch.zeros(4, 3, 1024, 1024), shot)
    assert len(followed) == len(MIXTURES["anywhere"])
    assert all(one.all() for one in followed.values())
