"""Gradients in a shot from the kernels' differences, against the float64 reference's."""

import dataclasses

import pytest
import torch
import torch.nn.functional as F

from moireaug import Scene, capture, develop, engine, expose
from moireaug.engine import differences, execution, kernel_stage, stages
from moireaug.mixtures import as_scenes
from moireaug.scene.by_name import values_of, with_values
from moireaug.scene.fields import bounds
from moireaug.scene.mixed_shot import MixedShot

MAX_ERROR = 0.05
LEAST_SHARE = 0.01  # of the greatest derivative, each by its field's range
FULL = {
    **{"panel.width": 0.0, "sensor.pitch": 0.0, "panel.scale": (0.8, 1.2), "sensor.scale": 2.0},
    "sensor.reading": "full",
}
ZERO_BEAT = {  # of the first harmonic, where its alias changes
    **{"sensor.pitch": (2.0, 2.0000001), "view.yaw": (0.0, 1e-3), "view.pitch": (0.0, 1e-3)},
    **{"view.roll": (0.0, 1e-3), "lens.k1": (0.0, 1e-6)},
}
GRAZING = {"view.yaw": (70.0, 75.0), "view.fov": (20.0, 30.0), "view.fit": True}
CAMERA_FRAME = {"develop.registered": False}
CASES = {
    "stripes": ("screen_photo", 16, {}),
    "chevrons": ("phone_at_laptop", 16, {}),
    "diamonds": ("phone_at_phone", 16, {}),
    "wrgb": ("phone_at_television", 16, {}),
    "LEDs": ("dashcam_at_led_sign", 48, {}),
    "a far screen": ("phone_across_room_at_television", 16, {}),
    "full reading": ("screen_photo", 16, FULL),
    "camera's frame": ("phone_at_monitor", 16, CAMERA_FRAME),
    "crop": ("screen_photo", 16, {"panel.width": 0.0, "sensor.shrink": (1.0, 3.0)}),
    "zero beat": ("screen_photo", 16, ZERO_BEAT),
    "grazing": ("phone_at_monitor", 16, GRAZING),
}


def scene_of(name, size, changes):
    """A preset whose sensor has one to three pixels a photo pixel, so that its moiré shows, and
    whose photo is no JPEG, whose rounding differs between float32 and float64."""
    scene = with_values(Scene.preset(name), {"develop.jpeg": 0.0})
    if not scene.is_crop:
        pitch = sum(bounds(scene.sensor.pitch)) / 2
        scene = with_values(scene, {"panel.width": (size / pitch, 3 * size / pitch)})
    return with_values(scene, changes)


def picture(size, n=1):
    small = torch.rand(n, 3, 4, 4, generator=torch.Generator().manual_seed(1))
    return F.interpolate(small, size=size, mode="bicubic").clamp(0.05, 0.95)


def ranged_fields(scene):
    """Fields that vary, each with the width of its range."""
    ends = {name: bounds(value) for name, value in values_of(scene).items()}
    return {name: high - low for name, (low, high) in ends.items() if low < high}


def gradients(stage, values, shot, fields):
    """The gradient in each field of a stage's results, along a fixed smooth direction."""
    numbers = shot.numbers()
    leaves = {name: numbers[name].clone().requires_grad_() for name in fields}
    if isinstance(shot, MixedShot):
        moved = dataclasses.replace(shot, drawn=numbers | leaves)
    else:
        moved = with_values(shot, leaves)
    results = stage(values, moved)
    generator = torch.Generator().manual_seed(7)
    along = torch.randn(results.shape[1:], dtype=torch.float64, generator=generator)
    along = F.avg_pool2d(along, 3, 1, 1).to(results)  # the same for each image
    return torch.autograd.grad((results * along).sum(), list(leaves.values()), allow_unused=True)


def worst_error(stage, values, shot):
    """The greatest relative error of a derivative that counts, and how many count."""
    widths = ranged_fields(shot.scene)
    got = gradients(stage, values, shot, widths)
    expected = gradients(stage, values.double(), shot, widths)
    zero = torch.zeros(len(shot), dtype=torch.float64)
    errors, sizes = [], []
    for one, true, width in zip(got, expected, widths.values(), strict=True):
        true = zero if true is None else true
        errors.append(((zero if one is None else one) - true).abs().max() * width)
        sizes.append(true.abs().max() * width)
    errors, sizes = torch.stack(errors), torch.stack(sizes)
    counts = sizes > LEAST_SHARE * sizes.max()
    return float((errors / sizes)[counts].max()), int(counts.sum())


@pytest.mark.parametrize("name", CASES)
def test_every_field_of_each_stage(name):
    preset, size, changes = CASES[name]
    shot = scene_of(preset, size, changes).sample(1, (size, size), torch.Generator().manual_seed(0))
    images = picture((size, size))
    with engine.reference():
        raw = expose(images, shot)
    for stage, values in ((expose, images), (develop, raw)):
        error, count = worst_error(stage, values, shot)
        assert count > 2 and error < MAX_ERROR, (stage, error)


@pytest.mark.parametrize("shift", [1e-8, 0.5])
def test_a_step_that_is_far_too_small_or_too_large_is_found(shift, monkeypatch):
    """The negative control: the panel moves by `shift` sensor pixels."""
    monkeypatch.setattr(stages.Exposing, "max_shift", shift)
    monkeypatch.setattr(differences, "MAX_RELATIVE_STEP", 1e3 * shift)
    preset, size, changes = CASES["stripes"]
    shot = scene_of(preset, size, changes).sample(1, (size, size), torch.Generator().manual_seed(0))
    assert worst_error(expose, picture((size, size)), shot)[0] > MAX_ERROR


SMALL = scene_of("screen_photo", 12, {})


def small_shot(n=2, scene=SMALL):
    return scene.sample(n, (12, 12), torch.Generator().manual_seed(0))


@pytest.mark.parametrize(("field", "limit"), [("panel.lit_x", 1.0), ("panel.black", 0.0)])
def test_a_number_at_its_limit_has_a_one_sided_difference(field, limit):
    shot = small_shot()
    shot = with_values(shot, {field: torch.full((2,), limit, dtype=torch.float64)})
    above, below = differences.step_ends(shot, [field], 0.003)
    assert (above.max() == limit) != (below.min() == limit)
    images = picture((12, 12), 2)
    (got,), (true,) = (gradients(expose, x, shot, [field]) for x in (images, images.double()))
    torch.testing.assert_close(got, true, rtol=MAX_ERROR, atol=0)


def test_numbers_that_do_not_vary_cost_nothing(monkeypatch):
    launched, images, shot = [], picture((12, 12), 2), small_shot()
    kernels = kernel_stage.kernels_of(execution.call_of(shot, None, images).execution.backend)
    for name in ("launch_expose", "launch_develop"):
        launch = getattr(kernels, name)

        def counted(values, *given, launch=launch, name=name, **records):
            launched.append((name, len(values)))
            return launch(values, *given, **records)

        monkeypatch.setattr(kernels, name, counted)
    gradients(capture, images, shot, ["view.yaw", "develop.red"])
    # the photo; then two readings for the one, and two photos for each, of two images
    forward = [("launch_expose", 2), ("launch_develop", 2)]
    assert launched[:2] == forward
    assert sorted(launched[2:]) == [("launch_develop", 8), ("launch_expose", 4)]


def test_images_of_a_batch_and_of_a_mixture_have_the_gradients_of_each():
    fields, images = ["view.yaw", "sensor.pitch", "develop.contrast"], picture((12, 12), 3)
    mixture = as_scenes([SMALL, scene_of("phone_at_monitor", 12, {})])
    for scene in (SMALL, mixture):
        shot = small_shot(3, scene)
        whole = gradients(capture, images, shot, fields)
        for i in range(3):
            one = gradients(capture, images[i : i + 1], shot[i : i + 1], fields)
            for all_images, single in zip(whole, one, strict=True):
                torch.testing.assert_close(all_images[i : i + 1], single, rtol=1e-3, atol=1e-6)


def test_a_second_derivative_is_that_of_the_reference():
    images, shot = picture((12, 12)), small_shot(1)
    second = []
    for values in (images, images.double()):
        gain = shot.sensor.gain.clone().requires_grad_()
        total = expose(values, with_values(shot, {"sensor.gain": gain})).square().sum()
        (slope,) = torch.autograd.grad(total, gain, create_graph=True)
        second += torch.autograd.grad(slope.sum(), gain)
    torch.testing.assert_close(*second, rtol=MAX_ERROR, atol=0)


def test_point_exposures_have_the_slope_of_the_reference(monkeypatch):
    monkeypatch.setattr(differences, "gradients", lambda *_: pytest.fail("differences are taken"))
    scene = Scene.preset("paper")
    gradients(expose, picture((12, 12)), scene.sample(1, (12, 12)), ["view.roll"])
    assert "gradient on cpu    in the shot: reference: readings of" in engine.explain(scene)
    assert "gradient on cpu    in the shot: differences of numba" in engine.explain(SMALL)


@pytest.mark.parametrize("changes", [{"sensor.bits": 8}, {"develop.denoise": "bilateral"}])
def test_steps_of_a_converter_and_effects_without_kernels_are_passed_through(changes):
    scene = with_values(scene_of("screen_photo", 12, FULL), changes | {"develop.jpeg": 0.0})
    shot, images, fields = small_shot(1, scene), picture((12, 12)), ["view.roll", "sensor.gain"]
    got, true = (gradients(capture, x, shot, fields) for x in (images, images.double()))
    torch.testing.assert_close(got, true, rtol=MAX_ERROR, atol=0)
