"""The engine's development equals the reference, and its gradient autograd's."""

import pytest
import torch

from moireaug import Develop, Lens, Scene, Sensor, View, develop
from moireaug.camera import pipeline
from moireaug.engine import execution
from moireaug.scene.by_name import with_values
from moireaug.scene.presets import PRESETS
from tests.engine.scenes import SCENES as EXPOSED

BENT = Lens(k1=0.05, k2=-0.02)
TURNED = View(yaw=20.0, pitch=-8.0, roll=10.0)


def scene(sensor, view=None, lens=None, **develop):
    """A scene whose codes are of light."""
    develop = Develop(**{"linear_light": True, **develop})
    return Scene(view=view or View(), lens=lens or Lens(), sensor=sensor, develop=develop)


TWICE, BRIGHT = Sensor(scale=2.0), Sensor(scale=2.0, gain=2.0)
MIXED = Sensor(scale=2.0, gain=2.0, crosstalk=0.15)
BETWEEN, LARGE = Sensor(scale=2.5), Sensor(scale=8.0)
COLOURS = {
    "red": 1.3, "blue": 0.8, "saturation": (0.6, 1.5), "shoulder": (0.0, 1.5),
    "contrast": (-0.5, 0.8), "brighten": 0.05,
}  # fmt: skip
FILTERED = {**COLOURS, "chroma_blur": (0.0, 1.5), "sharpen": (0.2, 1.0), "sharpen_radius": 0.8}
SCENES = {
    "codes": scene(TWICE, linear_light=False),
    "light": scene(BRIGHT),
    "registered and bent": scene(BRIGHT, TURNED, BENT),
    "nearly folded": scene(Sensor(), lens=Lens(k1=0.9, k2=-0.71)),
    "pincushion": scene(BRIGHT, lens=Lens(k1=-0.1)),
    "one": scene(Sensor(gain=2.0)),
    "three": scene(Sensor(scale=3.0, gain=2.0)),
    "two and a half, area": scene(Sensor(scale=2.5, gain=2.0)),
    "two and a half, antialias": scene(BETWEEN, resize="antialias"),
    "two, antialias": scene(TWICE, resize="antialias"),
    "a half, antialias": scene(Sensor(scale=0.5), resize="antialias"),
    "a half, area": scene(Sensor(scale=0.5)),
    "two, point": scene(TWICE, resize="point"),
    "nine, point": scene(Sensor(scale=9.0), resize="point"),
    "eight, point": scene(LARGE, resize="point"),
    "eight, point, malvar": scene(LARGE, resize="point", demosaic="malvar"),
    "malvar": scene(TWICE, demosaic="malvar"),
    "no colour filters": scene(Sensor(scale=2.0, cfa="none")),
    "no colour filters, antialias": scene(Sensor(scale=2.5, cfa="none"), resize="antialias"),
    "colour matrix without crosstalk": scene(TWICE, linear_light=False, saturation=0.4, red=1.3),
    "tone curve": scene(BRIGHT, shoulder=(0.0, 10.0), contrast=(-0.9, 0.9), brighten=0.1),
    "tone curve on codes": scene(TWICE, linear_light=False, contrast=0.7),
    "chroma blur": scene(TWICE, linear_light=False, chroma_blur=(0.5, 2.0)),
    "sharpen": scene(TWICE, linear_light=False, sharpen=(0.3, 1.5), sharpen_radius=(0.5, 2.0)),
    "every colour": scene(MIXED, TURNED, BENT, **COLOURS),
    "everything": scene(MIXED, TURNED, BENT, **FILTERED),
    "everything, no colour filters": scene(
        Sensor(scale=2.5, cfa="none", crosstalk=0.15), TURNED, **FILTERED
    ),
    "everything, two and a half, point": scene(
        Sensor(scale=2.5, crosstalk=0.15), TURNED, **FILTERED, resize="point", demosaic="malvar"
    ),
    "everything, camera's frame": scene(
        Sensor(crosstalk=0.15), TURNED, **FILTERED, registered=False
    ),
    "too little to sharpen, point": scene(
        LARGE, linear_light=False, sharpen=0.0005, resize="point"
    ),
    "everything, antialias": scene(BETWEEN, TURNED, **FILTERED, resize="antialias"),
    "everything, denoised": scene(MIXED, TURNED, BENT, **FILTERED, denoise="bilateral"),
    "bits": scene(Sensor(scale=2.0, bits=6)),
}


def assert_equals_the_reference(scene, size):
    """Compare photo and gradient with the reference's in float64, of a reading that leaves
    [0, 1]."""
    shot = scene.sample(2, size)
    reading = torch.rand(shot.raw_shape()) * 1.3 - 0.1
    reading[..., :3] = reading[..., :3].round()  # exactly on the bounds, too
    raw, precise = reading.clone().requires_grad_(), reading.double().requires_grad_()
    assert not execution.call_of(shot, None, raw).execution.why_not_develop
    photo, expected = develop(raw, shot), pipeline.develop(precise, shot)
    ahead = torch.randn_like(photo)
    (grad,) = torch.autograd.grad(photo, raw, ahead)
    (slope,) = torch.autograd.grad(expected, precise, ahead.double())
    assert (photo - expected).abs().max() < 1e-5
    assert (grad - slope).norm() <= 1e-4 * slope.norm()


def test_every_effect_that_is_said_to_have_a_kernel_is_compared():
    scenes, compared = [*SCENES.values(), *EXPOSED.values()], set()
    for scene in [*scenes, *map(Scene.preset, PRESETS)]:
        compared |= {*scene.plan().exposing, *scene.plan().developing}
    assert compared >= execution.ENGINE_EXPOSING | execution.ENGINE_DEVELOPING


@pytest.mark.parametrize("name", SCENES)
def test_equals_the_reference_and_its_gradient(name):
    assert_equals_the_reference(SCENES[name], (19, 26))


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (9, 1), (2, 2), (17, 67)])
@pytest.mark.parametrize(
    "name", ["registered and bent", "two and a half, area", "eight, point", "malvar", "everything"]
)
def test_any_size(name, size):
    assert_equals_the_reference(SCENES[name], size)


@pytest.mark.parametrize(
    ("name", "field", "value"),
    [
        ("every colour", "saturation", 2.5),
        ("every colour", "contrast", 0.9),
        ("every colour", "shoulder", 2.5),
        ("everything", "chroma_blur", 3.0),
        ("everything", "sharpen", 1.5),
        ("everything", "registered", False),
        ("malvar", "demosaic", "bilinear"),
    ],
)
def test_another_development_is_not_equal(name, field, value):
    scene = SCENES[name]
    changed = with_values(scene, {f"develop.{field}": value})
    raw = torch.rand(scene.sample(1, (19, 26)).raw_shape())
    photo = develop(raw, changed.sample(1, (19, 26), torch.Generator().manual_seed(1)))
    shot = scene.sample(1, (19, 26), torch.Generator().manual_seed(1))
    assert (photo - pipeline.develop(raw.double(), shot)).abs().max() > 0.01


def test_numbers_changed_in_place_are_developed_anew():
    shot = SCENES["every colour"].sample(1, (9, 12))
    raw = torch.rand(shot.raw_shape())
    before = develop(raw, shot)
    shot.develop.contrast.data *= -1  # which counts no version of the tensor
    photo = develop(raw, shot)
    assert (photo - before).abs().max() > 0.01
    assert (photo - pipeline.develop(raw.double(), shot)).abs().max() < 1e-5


@pytest.mark.parametrize(("name", "half"), [("light", False), ("everything", True)])
def test_the_gradient_of_a_gradient_is_the_references(name, half):
    shot = SCENES[name].sample(1, (6, 6), torch.Generator().manual_seed(0))
    raw = torch.rand(shot.raw_shape())
    weight = torch.rand(1, 3, 6, 6, dtype=torch.float64)

    def second(given):
        given.requires_grad_()
        photo = develop(given * 1.0, shot)
        loss = (photo.double() ** 2 * weight).sum()
        with torch.autocast("cpu", torch.bfloat16, enabled=half):  # which the camera ignores
            (grad,) = torch.autograd.grad(loss, given, create_graph=True)
        return torch.autograd.grad(grad.square().sum(), given)[0].double()

    found, expected = second(raw.clone()), second(raw.double())
    assert expected.norm() > 0
    assert (found - expected).norm() < 1e-3 * expected.norm()


@pytest.mark.parametrize("name", ["light", "everything"])
def test_gradients_of_several_values_at_once_are_those_of_each(name):
    shot = SCENES[name].sample(1, (6, 6), torch.Generator().manual_seed(0))
    raw = torch.rand(shot.raw_shape())

    def some(given):
        return develop(given, shot)[0, 1, 3, :4]

    each = torch.autograd.functional.jacobian(some, raw)
    together = torch.autograd.functional.jacobian(some, raw, vectorize=True)
    assert each.norm() > 0 and (together - each).norm() < 1e-4 * each.norm()
