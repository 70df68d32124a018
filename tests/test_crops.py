"""Images that are parts of photos: a part of a photo is the photo of that part."""

import dataclasses
import json
import math
import pickle

import pytest
import torch
import torch.nn.functional as F

from moireaug import (
    Develop,
    Lens,
    Panel,
    Scene,
    Sensor,
    Shot,
    View,
    capture,
    scenes,
    transforms,
)
from moireaug.camera import pipeline
from moireaug.engine import reference
from moireaug.mixtures import as_scenes
from moireaug.scene.sized import scene_of_size
from moireaug.synthesis.twins import without_moire
from moireaug.transforms import _scenes

TURNED = View(yaw=(-20.0, 20.0), pitch=(-12.0, 12.0), roll=(-8.0, 8.0), fov=(30.0, 50.0))
BENT = Lens(k1=(-0.03, 0.05), blur=(0.3, 0.5), vignetting=0.3)
LCD = Panel(lit_y=0.6, glare=0.1, glare_x=0.4, glare_y=-0.3, black=0.01)
CAMERA_FRAME = Develop(registered=False)
LEDS = Panel(width=(48.0, 256.0), layout="led", lit=0.6)
PULSED = dataclasses.replace(LCD, width=(150.0, 300.0), pwm=240.0, duty=0.6)


def on_lcd(**panel):
    return {"panel": dataclasses.replace(LCD, **panel), "view": TURNED, "lens": BENT}


SCENES = {
    "whole photo": Scene(**on_lcd(width=(150.0, 300.0)), sensor=Sensor(pitch=(1.8, 2.8))),
    "coarse panel": Scene(**on_lcd(width=(40.0, 70.0)), sensor=Sensor(pitch=(1.2, 1.8))),
    "crop": Scene(**on_lcd(), sensor=Sensor(pitch=(1.2, 2.8), shrink=(1.0, 3.0))),
    "known size": Scene(panel=LEDS, view=TURNED, lens=BENT, sensor=Sensor(shrink=(1.0, 3.0))),
    "pulses": Scene(
        panel=PULSED, view=TURNED, sensor=Sensor(pitch=2.1, shutter=0.01, readout=0.02)
    ),
    "camera's frame": Scene(
        panel=LCD, lens=BENT, view=View(yaw=5.0, roll=2.0),
        sensor=Sensor(pitch=(1.2, 2.8), shrink=(1.0, 3.0)), develop=CAMERA_FRAME,
    ),
    "light": Scene(
        **on_lcd(layout="pentile_diamond"),
        sensor=Sensor(pitch=(1.2, 2.8), shrink=(1.0, 2.0), gain=2.0, crosstalk=0.2),
        develop=Develop(linear_light=True, resize="antialias", chroma_blur=1.0, sharpen=0.3),
    ),
}  # fmt: skip
PART = (12, 24, 48, 44)  # top, left, height, width
MARGIN = 10


def smooth_images(n, size, seed=0):
    coarse = torch.rand(n, 3, 20, 24, generator=torch.Generator().manual_seed(seed))
    return F.interpolate(coarse, size=size, mode="bicubic").clamp(0, 1)


def difference(scene, images):
    """A part of the whole photo, minus the photo of the part, away from its edges."""
    shot = scene.sample(len(images), images.shape[-2:], torch.Generator().manual_seed(1))
    top, left, h, w = PART
    part = slice(top, top + h), slice(left, left + w)
    whole = capture(images, shot)[:, :, *part]
    photo = capture(images[:, :, *part].contiguous(), shot.crop(*PART))
    assert whole.std() > 0.01
    return (whole - photo)[..., MARGIN:-MARGIN, MARGIN:-MARGIN]


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_a_part_of_a_photo_is_the_photo_of_that_part(scene):
    images = smooth_images(3, (80, 96))
    with reference():
        assert difference(scene, images.double()).abs().max() < 1e-8
    assert difference(scene, images).abs().max() < 1 / 1024


def test_which_tells_places_apart():
    """The phase of the pattern, the perspective and the light of another place are seen."""
    shot = SCENES["crop"].sample(3, (80, 96), torch.Generator().manual_seed(1))
    image = torch.full((3, 3, 48, 44), 0.5)
    here, there = (capture(image, shot.crop(*corner, 48, 44)) for corner in ((12, 24), (13, 25)))
    assert (here - there).abs().mean() > 0.005


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
@pytest.mark.parametrize("size", [(33, 17), (1, 1), (1, 40)])
def test_kernels_read_crops_as_the_reference(scene, size):
    images = torch.rand(3, 3, *size, generator=torch.Generator().manual_seed(2))
    shot = scene.sample(3, size, torch.Generator().manual_seed(3))
    photo = capture(images, shot)
    with reference():
        expected = capture(images, shot)
    assert photo.isfinite().all()
    assert (photo - expected).square().mean().sqrt() < 2e-4
    assert (photo - expected).abs().max() < 1 / 512


def test_gradients_of_crops_are_those_of_the_reference():
    scene, weights = SCENES["crop"], torch.randn(2, 3, 24, 20)
    images = torch.rand(2, 3, 24, 20, requires_grad=True)
    shot = scene.sample(2, (24, 20), torch.Generator().manual_seed(4))
    (grad,) = torch.autograd.grad((capture(images, shot) * weights).sum(), images)
    with reference():
        (expected,) = torch.autograd.grad((capture(images, shot) * weights).sum(), images)
    assert (grad - expected).norm() < 2e-3 * expected.norm()


def test_two_of_width_pitch_and_shrink_give_the_third():
    """width * pitch = shrink * longer side, times the zoom."""
    zoomed = {"view": View(zoom=0.8), "lens": Lens(blur=0.4)}
    crop = Scene(sensor=Sensor(pitch=2.0, shrink=3.0), **zoomed).sample(1, (30, 40))
    assert crop.panel_scale.item() == pytest.approx(3 * 0.8 / 2)
    thing = Scene(panel=Panel(width=60.0), sensor=Sensor(shrink=3.0), **zoomed)
    shot = thing.sample(1, (30, 40))
    assert shot.panel_scale.item() == 60 / 40 and shot.sensor_scale.item() == 3
    assert (
        scene_of_size(thing, (30, 40)).sensor.pitch[0]
        <= 3 * 0.8 * 40 / 60
        <= scene_of_size(thing, (30, 40)).sensor.pitch[1]
    )


REFUSED = {
    "one": (lambda: Scene(sensor=Sensor(shrink=2.0)), "one of Panel.width and Sensor.pitch"),
    "three": (
        lambda: Scene(panel=Panel(width=50.0), sensor=Sensor(pitch=1.0, shrink=1.0)),
        "one of Panel.width and Sensor.pitch",
    ),
    "both scales": (
        lambda: Sensor(shrink=2.0, scale=3.0), "Sensor.shrink and Sensor.scale say the same thing"
    ),
    "small": (lambda: Sensor(shrink=(0.0, 2.0)), "Sensor.shrink must be at least 0.1"),
    "full": (
        lambda: Scene(sensor=Sensor(pitch=2.0, shrink=2.0, reading="full")), "does not fix"
    ),
    "paper": (lambda: Scene.preset("paper").with_shrink(2.0), "Panel.scale and Sensor.scale"),
    "a tensor": (
        lambda: SCENES["crop"].with_shrink(torch.tensor([1.0, 3.0])), "must be a number or a"
    ),
    "off": (lambda: SCENES["crop"].with_shrink(0.0), "at least 0.1; got 0"),
    "enormous": (
        lambda: Scene(panel=Panel(width=1.0), sensor=Sensor(shrink=99.0)).plan((900, 900)),
        "Raise Panel.width",
    ),
    "outside": (
        lambda: SCENES["crop"].sample(1, (9, 9)).crop(2, 0, 8, 9), "within the image of 9 x 9"
    ),
    "half a pixel": (
        lambda: SCENES["crop"].sample(1, (9, 9)).crop(4.5, 0, 4, 4), "whole numbers of pixels; got"
    ),
    "part of a full reading": (
        lambda: Scene().sample(1, (9, 9)).crop(0, 0, 8, 8), "this shot's is full"
    ),
}  # fmt: skip


@pytest.mark.parametrize(("build", "message"), REFUSED.values(), ids=REFUSED)
def test_what_a_crop_cannot_be_is_said(build, message):
    with pytest.raises((TypeError, ValueError), match=message):
        build()


def test_a_sign_is_planned_however_far_a_pitch_that_nobody_states_spreads():
    # ranges of shrink and zoom multiply in the pitch that follows from Panel.width
    sign = Scene(panel=LEDS, view=View(zoom=(0.3, 2.0)), sensor=Sensor(shrink=(0.1, 10.0)))
    assert sign.plan((1024, 1024)).exposure == "spectral"


def test_parts_of_parts_and_records_of_them():
    shot = SCENES["crop"].sample(2, (40, 50), torch.Generator().manual_seed(0))
    nested = shot.crop(4, 6, 30, 30).crop(2, 3, 20, 24)
    straight = shot.crop(6, 9, 20, 24)
    image = torch.rand(2, 3, 20, 24)
    again = Shot.from_dict(json.loads(json.dumps(nested.to_dict())))
    for other in (nested, again, straight[:1]):
        assert torch.equal(
            capture(image[: len(other)], other), capture(image, straight)[: len(other)]
        )


def test_points_follow_a_crop_in_the_cameras_frame():
    """A white dot is photographed where `to_photo` says."""
    shot = SCENES["camera's frame"].sample(1, (40, 40), torch.Generator().manual_seed(5))
    image = torch.zeros(1, 3, 40, 40)
    image[..., 26:30, 11:15] = 1
    with reference():
        still = without_moire(shot, noise=False)
        light = capture(image.double(), still) - capture(torch.zeros_like(image.double()), still)
    light = light[0].mean(0)
    rows, cols = torch.meshgrid(*[torch.arange(40) + 0.5] * 2, indexing="ij")
    weight = light / light.sum()
    seen = torch.stack(((weight * cols).sum(), (weight * rows).sum()))
    expected = shot.to_photo(torch.tensor([[[13.0, 28.0]]], dtype=torch.float64))[0, 0]
    assert (seen - expected).abs().max() < 0.3


@pytest.mark.parametrize("focal", [0.3, 0.75, 2.0])
@pytest.mark.parametrize("shrink", [1.0, 3.0])
@pytest.mark.parametrize("place", [0.3, 0.5, 0.7])
def test_a_crop_has_the_perspective_of_the_camera_that_its_photo_is_of(focal, shrink, place):
    """At u from the axis, a plane turned by an angle is magnified by cos(angle) (1 - u / f
    tan(angle))^2 along u."""
    scene = Scene(
        view=View(yaw=20.0),
        sensor=Sensor(pitch=2.0, shrink=shrink, crop_x=place, crop_y=0.5, focal=focal),
        develop=CAMERA_FRAME,
    )
    shot = scene.sample(1, (40, 40))
    points = torch.tensor([[[19.99, 20.0], [20.01, 20.0]]], dtype=torch.float64)
    photo = shot.to_photo(points)[0, :, 0]
    side = 4032 / shrink  # photo pixels
    u = (place - 0.5) * (side - 40)
    yaw = math.radians(20)
    expected = math.cos(yaw) * (1 - u / (focal * side) * math.tan(yaw)) ** 2
    assert (photo[1] - photo[0]).item() / 0.02 == pytest.approx(expected, rel=1e-3)


def test_draws_of_whole_photos_take_no_numbers_for_a_place():
    """Draws of the paper's scene stay as they were: its ranges, the phase and the seed."""
    assert Scene.preset("paper").random_numbers(1).shape == (1, 4)


@pytest.mark.parametrize("size", [32, 48, 112])
def test_crops_show_moire_where_whole_photos_show_none(size):
    images = smooth_images(16, (size, size))
    medians = {}
    for shrink in (None, (1, 3)):
        scene = as_scenes("screen_photo", shrink)
        shot = scene.sample(16, (size, size), torch.Generator().manual_seed(0))
        moire = capture(images, shot) - capture(images, without_moire(shot))
        medians[shrink] = 255 * moire.square().mean((1, 2, 3)).sqrt().median().item()
        expected = scene.expected_moire((size, size))
        assert expected.low / 2 < medians[shrink] < 2 * expected.high
    assert medians[None] < 1.5 < 2 < medians[1, 3] < 10


def test_the_moire_to_expect_is_that_of_the_size_whichever_was_asked_first():
    scene = Scene.preset("screen_photo")
    at_255 = scene.expected_moire((255, 255)).median
    for first in (128, 255):
        asked = dataclasses.replace(scene)
        asked.plan((first, first))
        assert asked.plan((255, 255)).moire.median == at_255
    assert at_255 > 2 * scene.expected_moire((128, 128)).median


def test_a_scene_is_planned_without_its_moire_and_once_a_process(monkeypatch):
    """As a shot is, when it comes from a worker."""

    def fails(_):
        raise AssertionError("estimated again")

    shot = as_scenes("screen_photo", (1, 3)).sample(2, (48, 48))
    monkeypatch.setattr(scenes, "moire_of", fails)
    monkeypatch.setattr(pipeline, "method_of", fails)
    copied = pickle.loads(pickle.dumps(shot))
    assert copied.plan is shot.plan


def test_a_transform_says_once_that_no_moire_is_left(monkeypatch):
    said = []
    monkeypatch.setattr(_scenes, "_checked_octaves", set())
    monkeypatch.setattr(_scenes.logger, "warning", said.append)
    images = torch.rand(1, 3, 32, 32)
    for _ in range(2):
        transforms.RandomMoire("phone_at_monitor", p=1.0)(images)
    assert len(said) == 1 and "shrink=(1, 3)" in said[0]
    transforms.RandomMoire("phone_at_monitor", p=1.0, shrink=(1, 3))(images)
    assert len(said) == 1


def test_a_plan_says_what_an_image_pixel_gets_and_the_moire_to_expect():
    plan = str(as_scenes("screen_photo", (1, 3)).plan((48, 48)))
    assert "0.454545 to 2.30769 panel pixels and 1 to 3 sensor pixels" in plan
    assert "To expect: moiré of about" in plan
    assert "To expect" not in str(Scene.preset("paper").plan())
