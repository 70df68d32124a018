"""The engine's development equals the reference, and its gradient autograd's."""

import dataclasses

import pytest
import torch

from moireaug import Develop, Lens, Scene, Sensor, View, develop, pipeline
from moireaug.engine import program

LIGHT = Develop(linear_light=True)
BENT = Lens(k1=0.05, k2=-0.02)
TURNED = View(yaw=20.0, pitch=-8.0, roll=10.0)


def resized(resize, demosaic="bilinear"):
    return Develop(linear_light=True, resize=resize, demosaic=demosaic)


COLOURS = Develop(
    linear_light=True,
    red=1.3,
    blue=0.8,
    saturation=(0.6, 1.5),
    shoulder=(0.0, 1.5),
    contrast=(-0.5, 0.8),
    brighten=0.05,
)
FILTERED = dataclasses.replace(
    COLOURS, chroma_blur=(0.0, 1.5), sharpen=(0.2, 1.0), sharpen_radius=0.8
)
SCENES = {
    "codes": Scene(sensor=Sensor(scale=2.0)),
    "light": Scene(sensor=Sensor(scale=2.0, gain=2.0), develop=LIGHT),
    "registered": Scene(view=TURNED, sensor=Sensor(scale=2.0, gain=2.0), develop=LIGHT),
    "registered and bent": Scene(
        view=TURNED, lens=BENT, sensor=Sensor(scale=2.0, gain=2.0), develop=LIGHT
    ),
    "nearly folded": Scene(lens=Lens(k1=0.9, k2=-0.71), develop=LIGHT),
    "pincushion": Scene(lens=Lens(k1=-0.1), sensor=Sensor(scale=2.0, gain=2.0), develop=LIGHT),
    "one": Scene(sensor=Sensor(gain=2.0), develop=LIGHT),
    "three": Scene(sensor=Sensor(scale=3.0, gain=2.0), develop=LIGHT),
    "two and a half, area": Scene(sensor=Sensor(scale=2.5, gain=2.0), develop=LIGHT),
    "two and a half, antialias": Scene(sensor=Sensor(scale=2.5), develop=resized("antialias")),
    "two, antialias": Scene(sensor=Sensor(scale=2.0), develop=resized("antialias")),
    "a half, antialias": Scene(sensor=Sensor(scale=0.5), develop=resized("antialias")),
    "a half, area": Scene(sensor=Sensor(scale=0.5), develop=LIGHT),
    "two, point": Scene(sensor=Sensor(scale=2.0), develop=resized("point")),
    "nine, point": Scene(sensor=Sensor(scale=9.0), develop=resized("point")),
    "eight, point": Scene(sensor=Sensor(scale=8.0), develop=resized("point")),
    "eight, point, malvar": Scene(sensor=Sensor(scale=8.0), develop=resized("point", "malvar")),
    "malvar": Scene(sensor=Sensor(scale=2.0), develop=resized("area", "malvar")),
    "no colour filters": Scene(sensor=Sensor(scale=2.0, cfa="none"), develop=LIGHT),
    "no colour filters, antialias": Scene(
        sensor=Sensor(scale=2.5, cfa="none"), develop=resized("antialias")
    ),
    "balance": Scene(
        sensor=Sensor(scale=2.0, gain=2.0),
        develop=Develop(linear_light=True, red=1.8, blue=0.6, brighten=-0.1),
    ),
    "colour matrix": Scene(
        sensor=Sensor(scale=2.0, gain=2.0, crosstalk=(0.05, 0.2)),
        develop=Develop(linear_light=True, saturation=(0.5, 1.6)),
    ),
    "colour matrix without crosstalk": Scene(
        sensor=Sensor(scale=2.0), develop=Develop(saturation=0.4, red=1.3)
    ),
    "tone curve": Scene(
        sensor=Sensor(scale=2.0, gain=2.0),
        develop=Develop(
            linear_light=True, shoulder=(0.0, 10.0), contrast=(-0.9, 0.9), brighten=0.1
        ),
    ),
    "tone curve on codes": Scene(sensor=Sensor(scale=2.0), develop=Develop(contrast=0.7)),
    "chroma blur": Scene(sensor=Sensor(scale=2.0), develop=Develop(chroma_blur=(0.5, 2.0))),
    "sharpen": Scene(
        sensor=Sensor(scale=2.0), develop=Develop(sharpen=(0.3, 1.5), sharpen_radius=(0.5, 2.0))
    ),
    "every colour": Scene(
        view=TURNED, lens=BENT, sensor=Sensor(scale=2.0, gain=2.0, crosstalk=0.15), develop=COLOURS
    ),
    "everything": Scene(
        view=TURNED,
        lens=BENT,
        sensor=Sensor(scale=2.0, gain=2.0, crosstalk=0.15),
        develop=FILTERED,
    ),
    "everything, no colour filters": Scene(
        view=TURNED, sensor=Sensor(scale=2.5, cfa="none", crosstalk=0.15), develop=FILTERED
    ),
    "everything, two and a half, point": Scene(
        view=TURNED,
        sensor=Sensor(scale=2.5, crosstalk=0.15),
        develop=dataclasses.replace(FILTERED, resize="point", demosaic="malvar"),
    ),
    "everything, camera's frame": Scene(
        view=TURNED,
        sensor=Sensor(crosstalk=0.15),
        develop=dataclasses.replace(FILTERED, registered=False),
    ),
    "too little to sharpen, point": Scene(
        sensor=Sensor(scale=8.0), develop=Develop(sharpen=0.0005, resize="point")
    ),
    "everything, antialias": Scene(
        view=TURNED,
        sensor=Sensor(scale=2.5),
        develop=dataclasses.replace(FILTERED, resize="antialias"),
    ),
    "everything, denoised": Scene(
        view=TURNED,
        lens=BENT,
        sensor=Sensor(scale=2.0, gain=2.0, crosstalk=0.15),
        develop=dataclasses.replace(FILTERED, denoise="bilateral"),
    ),
    "bits": Scene(sensor=Sensor(scale=2.0, bits=6), develop=LIGHT),
}


def both(scene, size, n=2):
    """Photo and gradient by the kernels, and by the reference in float64, of a reading that leaves
    [0, 1]."""
    shot = scene.sample(n, size)
    reading = torch.rand(shot.raw_shape()) * 1.3 - 0.1
    reading[..., :3] = reading[..., :3].round()  # exactly on the bounds, too
    raw, precise = reading.clone().requires_grad_(), reading.double().requires_grad_()
    assert not program.program_of_call(raw, shot).why_not_develop
    photo, expected = develop(raw, shot), pipeline.develop(precise, shot)
    ahead = torch.randn_like(photo)
    (grad,), (slope,) = (
        torch.autograd.grad(photo, raw, ahead),
        torch.autograd.grad(expected, precise, ahead.double()),
    )
    return photo, expected, grad, slope


@pytest.mark.parametrize("name", SCENES)
def test_equals_the_reference_and_its_gradient(name):
    photo, expected, grad, slope = both(SCENES[name], (19, 26))
    assert (photo - expected).abs().max() < 1e-5
    assert (grad - slope).norm() < 1e-4 * slope.norm()


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (9, 1), (2, 2), (17, 67)])
@pytest.mark.parametrize(
    "name",
    ["registered and bent", "two and a half, area", "eight, point", "malvar", "everything"],
)
def test_any_size(name, size):
    photo, expected, grad, slope = both(SCENES[name], size)
    assert (photo - expected).abs().max() < 1e-5
    assert (grad - slope).norm() <= 1e-4 * slope.norm()


def test_another_demosaic_is_not_equal():
    shot = SCENES["malvar"].sample(1, (19, 26))
    raw = torch.rand(shot.raw_shape())
    other = SCENES["light"].sample(1, (19, 26))
    assert (develop(raw, other) - pipeline.develop(raw.double(), shot)).abs().max() > 1 / 512


@pytest.mark.parametrize(
    ("name", "field", "value"),
    [
        ("every colour", "saturation", 2.5),
        ("every colour", "contrast", 0.9),
        ("every colour", "shoulder", 2.5),
        ("everything", "chroma_blur", 3.0),
        ("everything", "sharpen", 1.5),
        ("everything", "registered", False),
    ],
)
def test_another_development_is_not_equal(name, field, value):
    scene = SCENES[name]
    changed = dataclasses.replace(
        scene, develop=dataclasses.replace(scene.develop, **{field: value})
    )
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


@pytest.mark.parametrize("half", [False, True])
@pytest.mark.parametrize("name", ["light", "everything"])
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
