"""The engine's exposure equals the reference in float64, on random pictures: the hardest there
are."""

import dataclasses

import numpy as np
import pytest
import torch

from moireaug import Develop, Layout, Lens, Panel, Scene, Sensor, View, expose
from moireaug.camera import pipeline
from moireaug.camera.effects.prefilter import MAX_NEIGHBOUR_VARIANCE, is_blurred, neighbour_share
from moireaug.camera.effects.sensor import lost_variances
from moireaug.capture import reading_of
from moireaug.engine import execution, stages
from moireaug.engine.cpu import expose_kernels, run
from moireaug.engine.lower.exposure import lower_exposure
from moireaug.scene.by_name import with_values
from moireaug.scene.presets import PRESETS
from tests.engine.readings import RMS, assert_equal, readings
from tests.engine.scenes import SCENES, random_binned_scene, random_scene


@pytest.mark.parametrize("name", SCENES)
def test_equals_the_reference(name):
    assert_equal(*readings(SCENES[name], (40, 52)))


@pytest.mark.parametrize(("lit", "gain"), [(0.2, 100.0), (0.02, 900.0)])
def test_what_is_faint_on_the_panel_is_amplified(lit, gain):
    scene = Scene(
        panel=Panel(layout="led_cob", lit=lit, scale=1.3), view=View(roll=3.0, yaw=5.0),
        lens=Lens(blur=0.3), sensor=Sensor(scale=2.0, gain=gain),
    )  # fmt: skip
    shot = scene.sample(1, (48, 48))
    images = torch.full((1, 3, 48, 48), 0.9)
    got = expose(images, shot)
    assert got.std() > 0.02  # it is not saturated
    assert_equal(got.double(), pipeline.expose(images.double(), shot))


@pytest.mark.parametrize(("registered", "n"), [(True, 2), (False, 8)])  # few views are oblique
@pytest.mark.parametrize("name", [name for name in PRESETS if not name.startswith("paper")])
def test_equals_the_reference_on_every_preset(name, registered, n):
    scene = with_values(Scene.preset(name), {"develop.registered": registered})
    assert_equal(*readings(scene, (24, 32), n))


@pytest.mark.parametrize(("pitch", "taps"), [(8.0, 3), (1.2, 5), (0.8, 7), (0.3, 7)])
@pytest.mark.parametrize("name", ["turned", "pentile", "camera's frame"])
def test_any_number_of_panel_pixels_in_view(name, pitch, taps):
    scene = with_values(SCENES[name], {"panel.scale": 2.0 / pitch})
    assert scene.plan().method.taps == taps
    assert_equal(*readings(scene, (24, 32)))


@pytest.mark.parametrize("execution", [expose, pipeline.expose])
def test_stripes_are_stripes_in_any_cell(execution):
    stripes = tuple((c, x + c / 3, 0, x + (c + 1) / 3, 1) for x in range(4) for c in range(3))
    images, readings = torch.rand(2, 3, 40, 52), []
    for layout in ("rgb_stripe", Layout(stripes, (4, 1))):
        scene = dataclasses.replace(SCENES["everything"], panel=Panel(layout=layout, lit=0.6))
        shot = scene.sample(2, (40, 52), torch.Generator().manual_seed(3))
        readings.append(execution(images, shot))
    assert (readings[0] - readings[1]).abs().max() < 1e-5


@pytest.mark.parametrize("part", range(6))
def test_random_scenes(part):
    for i in range(5):
        scene = random_scene(5 * part + i)
        shot = scene.sample(1, (14, 19), torch.Generator().manual_seed(i))
        images = torch.rand(1, 3, 14, 19, generator=torch.Generator().manual_seed(i))
        if not execution.call_of(shot, None, images).execution.why_not_expose:
            assert_equal(expose(images, shot).double(), pipeline.expose(images.double(), shot))


@pytest.mark.parametrize("part", range(3))
def test_random_binned_scenes(part):
    for i in range(6 * part, 6 * part + 6):
        assert_equal(*readings(random_binned_scene(i), (14, 19), n=1))


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (12, 1), (2, 2), (7, 33), (67, 30)])
@pytest.mark.parametrize("name", ["no colour filters", "two and a half", "everything"])
def test_any_size(name, size):
    assert_equal(*readings(SCENES[name], size))


@pytest.mark.parametrize(("size", "scale"), [((1, 1), 1.0), ((2, 2), 0.7), ((1, 40), 1.0)])
def test_a_single_row_is_where_the_lens_sees_it(size, scale):
    view, sensor = View(yaw=30.0, pitch=-35.0, roll=-152.0), Sensor(scale=scale, cfa="none")
    assert_equal(*readings(Scene(view=view, lens=Lens(k1=0.25), sensor=sensor), size))


STEEP = {
    "oblique": (Panel(scale=1.1), View(yaw=35.0, fov=40.0), Lens(blur=(0.2, 0.4)), (40, 40)),
    "barrel": (Panel(), View(), Lens(k1=0.1, k2=0.02, blur=0.3), (40, 40)),
    "pincushion": (Panel(), View(), Lens(k1=-0.08, blur=0.3), (31, 50)),
}


@pytest.mark.parametrize(("panel", "view", "lens", "size"), STEEP.values(), ids=STEEP)
def test_steep_views_that_fit_are_equal(panel, view, lens, size):
    scene = Scene(panel=panel, view=view, lens=lens, sensor=Sensor(scale=2.0))
    shot = scene.sample(1, size, torch.Generator().manual_seed(3))
    assert run.fits(*lower_exposure(shot, decoded=False)).tolist() == [True]
    assert_equal(*readings(scene, size, n=1))


def test_an_image_is_read_the_same_beside_one_of_the_horizon():
    scene = with_values(SCENES["turned"], {"view.yaw": (0.0, 85.0), "view.fov": 60.0})
    shot = scene.sample(3, (40, 40), torch.Generator().manual_seed(0))
    shot = with_values(shot, {"view.yaw": torch.tensor([5.0, 85.0, -5.0], dtype=torch.float64)})
    images = torch.rand(3, 3, 40, 40, generator=torch.Generator().manual_seed(1))
    assert run.fits(*lower_exposure(shot, decoded=False)).tolist() == [True, False, True]
    alone = [expose(images[i : i + 1], shot[i : i + 1]) for i in range(3)]
    assert torch.equal(expose(images, shot), torch.cat(alone))


def test_a_batch_of_none():
    shot = SCENES["turned"].sample(0, (8, 8))
    assert expose(torch.rand(0, 3, 8, 8), shot).shape == shot.raw_shape()


@pytest.mark.parametrize("name", ["turned", "light", "black level", "everything"])
def test_bytes_are_read_as_they_are(name):
    shot = SCENES[name].sample(3, (20, 24))
    codes = torch.randint(0, 256, (3, 3, 20, 24), dtype=torch.uint8)
    given = lower_exposure(shot, decoded=False)
    got, expected = (run.launch_expose(c, False, *given)[0] for c in (codes, codes.float() / 255))
    assert (got - expected).abs().max() < 2e-6


def test_a_crop_that_its_prefilter_leaves_sharp_is_not_blurred_as_the_photos_middle_is():
    scene = Scene(
        view=View(pitch=23.0, shift_y=-0.5), lens=Lens(motion_y=5.0),
        sensor=Sensor(pitch=1.5, shrink=2.0, exposure="mean"),
    )  # fmt: skip
    shot = scene.sample(1, (16, 16), torch.Generator().manual_seed(1))
    assert shot.plan.prefilter_variance > MAX_NEIGHBOUR_VARIANCE
    assert neighbour_share(shot) > 0.1
    assert not is_blurred(shot).any()
    images = torch.rand(1, 3, 16, 16)
    assert_equal(expose(images, shot).double(), pipeline.expose(images.double(), shot))


def test_a_lens_may_have_the_pictures_middle_off_a_photo_that_saturates():
    scene = Scene(
        panel=Panel(glare=2.0), view=View(shift_x=-0.6), lens=Lens(k1=-0.15),
        sensor=Sensor(pitch=2.5, shrink=1.5, crop_x=0.2, crop_y=0.5),
    )  # fmt: skip
    assert_equal(*readings(scene, (8, 8)))
    call = execution.call_of(scene.sample(1, (8, 8)), None, torch.zeros(1, 3, 8, 8))
    assert isinstance(stages.exposing(call), stages.Exposing)  # not the reference, with a warning


def test_a_crop_may_see_the_panel_much_larger_than_the_photos_middle_does():
    scene = Scene(
        panel=Panel(layout="led", lit=0.4, glare=1.0), view=View(yaw=75.0), lens=Lens(blur=0.1),
        sensor=Sensor(pitch=2.2, shrink=1.5, gain=2.5, focal=0.4, crop_x=0.0, crop_y=0.4),
        develop=Develop(registered=False),
    )  # fmt: skip
    shot = scene.sample(1, (12, 12))
    terms = expose_kernels.binned_setup_kernel(*lower_exposure(shot, decoded=False), 0).terms
    expected = lost_variances(shot)[2][0].float().numpy()
    np.testing.assert_allclose(terms.lost_pattern_variance, expected, rtol=1e-3)


def test_a_part_near_the_horizon_leaves_the_middles_transfer_as_it_is():
    scene = Scene(
        panel=Panel(lit=0.506, lit_x=0.551, lit_y=0.514, width=1440.404),
        view=View(yaw=-43.895, pitch=15.604, roll=71.598, shift_x=0.602, shift_y=0.786),
        lens=Lens(k1=0.171, k2=0.069, blur=0.087), develop=Develop(resize="antialias"),
        sensor=Sensor(
            fill=0.861, gain=6.135, shrink=5.931, focal=0.708, pixels=400.0, crop_x=0.287,
            crop_y=0.773,
        ),
    )  # fmt: skip
    shot = scene.sample(1, (96, 40))
    terms = expose_kernels.binned_setup_kernel(*lower_exposure(shot, decoded=False), 0).terms
    expected = lost_variances(shot)[2][0].float().numpy()
    np.testing.assert_allclose(terms.lost_pattern_variance, expected, atol=1e-4)


def test_beats_that_are_very_many_are_read_alike_at_nodes():
    scene = Scene.preset("dashcam_at_led_sign")
    scene = with_values(scene, {"sensor.read_noise": 0.0, "sensor.shot_noise": 0.0})
    shot = scene.sample(1, (8, 1024), torch.Generator().manual_seed(0))
    terms = expose_kernels.binned_setup_kernel(*lower_exposure(shot, decoded=False), 0).terms
    assert terms.lines.shape[1] < len(terms.harmonic) * 1024
    even, part = torch.full((1, 3, 8, 1024), 0.7), shot.crop(0, 480, 8, 32)
    difference = expose(even, shot)[..., 480:512] - pipeline.expose(even[..., :32].double(), part)
    # what each beat that is left out adds to the error
    assert difference.square().mean().sqrt() < 2 * RMS


def test_motion_may_pass_waves_along_a_narrow_strip_of_a_steep_view():
    scene = Scene(
        panel=Panel(layout="led", lit=0.5), view=View(yaw=60.0, pitch=10.0, roll=7.0),
        lens=Lens(blur=0.3, motion_x=8.0), develop=Develop(linear_light=True),
        sensor=Sensor(pitch=6.0, shrink=3.0, pixels=400.0, crop_x=0.3, crop_y=0.5),
    )  # fmt: skip
    assert_equal(*readings(scene, (48, 48), n=1))


def test_kernels_follow_a_steep_view_at_a_tight_tolerance():
    scene = Scene(
        view=View(yaw=40.0, pitch=-30.0, roll=12.0, fov=60.0), lens=Lens(blur=0.3),
        sensor=Sensor(pitch=1.5, shrink=3.0), develop=Develop(registered=False),
        tolerance=Scene.tolerance / 16,
    )  # fmt: skip
    call = execution.call_of(scene.sample(1, (40, 52)), None, torch.zeros(1, 3, 40, 52))
    assert isinstance(stages.exposing(call), stages.Exposing)  # not the reference, with a warning
    assert_equal(*readings(scene, (40, 52)))


def test_kernels_follow_a_whole_photo_of_a_tilted_screen_at_a_tight_tolerance():
    """As of screens in rooms; tap weights need 25 x 91 nodes."""
    scene = Scene(
        panel=Panel(layout="chevron", lit_x=0.7, lit_y=0.47),
        view=View(yaw=7.16, pitch=18.2, roll=-1.5), lens=Lens(blur=0.56, k1=0.011),
        sensor=Sensor(
            pitch=1.415, shrink=7.045, pixels=4032.0, focal=0.75, crop_x=0.483, crop_y=0.637,
            read_noise=0.0, shot_noise=0.0,
        ),
        develop=Develop(registered=False), tolerance=3e-4,
    )  # fmt: skip
    shot, even = scene.sample(1, (512, 288)), torch.full((1, 3, 512, 288), 0.7)
    stage = stages.exposing(execution.call_of(shot, None, even))
    assert isinstance(stage, stages.Exposing)  # not the reference, with a warning
    part = shot.crop(480, 200, 24, 32)
    expected = pipeline.expose(even[..., :24, :32].double(), part)
    assert_equal(expose(even, shot)[..., 480:504, 200:232].double(), expected)


def test_bytes_are_read_as_they_are_through_a_prefilter_that_varies():
    shot = SCENES["black level, prefilter that varies"].sample(2, (20, 24))
    assert shot.plan.prefilter_variance > MAX_NEIGHBOUR_VARIANCE
    codes = torch.randint(0, 256, (2, 3, 20, 24), dtype=torch.uint8)
    assert torch.equal(reading_of(codes, shot), reading_of(codes.float() / 255, shot))


def test_threads_and_parts_of_a_batch_change_nothing():
    shot, images = SCENES["noise"].sample(5, (20, 24)), torch.rand(5, 3, 20, 24)
    torch.set_num_threads(1)
    alone = expose(images, shot)
    torch.set_num_threads(3)
    assert torch.equal(alone, expose(images, shot))
    assert torch.equal(alone[2:4], expose(images[2:4], shot[2:4]))


@pytest.mark.parametrize(
    ("field", "factor"), [("lens.blur", 1.1), ("panel.scale", 1.0005), ("seed", 2)]
)
def test_another_shot_is_not_equal(field, factor):
    shot = SCENES["noise"].sample(1, (40, 52))
    if field == "seed":
        other = dataclasses.replace(shot, seed=shot.seed + 1)
    else:
        other = with_values(shot, {field: factor * shot.numbers()[field]})
    image = torch.rand(1, 3, 40, 52)
    got, expected = expose(image, other).double(), pipeline.expose(image.double(), shot)
    with pytest.raises(AssertionError):
        assert_equal(got, expected)
