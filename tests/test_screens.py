"""Scenes that are screens: as large and as finely photographed as they say, whatever the size of
the picture."""

import dataclasses
import re

import pytest
import torch
import torch.nn.functional as F

from moireaug import Develop, Layout, Lens, Panel, Scene, Sensor, View, capture, expose
from moireaug.camera import pipeline
from moireaug.camera.effects.sensor import pixels_per_value
from moireaug.camera.exposure import extreme_readings
from moireaug.camera.exposure.bin_geometry import pixels_on_photo
from moireaug.engine import backends
from moireaug.scene.presets import PRESETS
from moireaug.scene.sized import scene_of_size
from moireaug.synthesis import without_moire
from tests.engine.readings import assert_equal, readings

SWAYED = View(yaw=(-15.0, 15.0), roll=(-5.0, 5.0))
PARTS = {"panel": Panel(width=(150.0, 300.0)), "sensor": Sensor(pitch=(1.8, 2.4))}
SCREEN = Scene(view=SWAYED, lens=Lens(blur=0.4), **PARTS)


def rms(difference):
    return float(difference.square().mean().sqrt())


@pytest.mark.parametrize("size", [(40, 64), (64, 40), (1, 1), (300, 500)])
def test_a_screen_has_its_pixels_at_any_size(size):
    shot = SCREEN.sample(3, size, torch.Generator().manual_seed(0))
    assert torch.allclose(shot.panel_scale * max(size), shot.panel.width)
    # of the picture's longer side, before it is turned, as the sensor sees it
    shown = max(size) * shot.sensor_scale / shot.panel.width
    frontal = dataclasses.replace(SCREEN, view=View(roll=SCREEN.view.roll, fit=False))
    seen = frontal.sample(3, size, torch.Generator().manual_seed(0))
    assert torch.allclose(seen.sensor_scale, seen.sensor.pitch * seen.panel_scale)
    assert (shown >= shot.sensor.pitch - 1e-9).all()  # stepping back makes the picture smaller
    assert shot.raw_shape() == (3, 4, *size)


def test_stepping_back_and_zooming_in_keep_the_pitch():
    """The pitch is that of the photo as taken: a picture half as large has half as many of the
    sensor's pixels in a photo pixel."""
    for zoom in (0.5, 1.0, 2.0):
        scene = dataclasses.replace(SCREEN, view=View(zoom=zoom, fit=False))
        shot = scene.sample(2, (30, 40), torch.Generator().manual_seed(1))
        assert torch.allclose(shot.sensor_scale * zoom, shot.sensor.pitch * shot.panel_scale)


RANGED, FIXED, FULL = Panel(width=(100.0, 200.0)), Panel(width=99.0), Sensor(reading="full")
SENTENCES = [
    (lambda: Panel(width=100.0, scale=2.0), "Panel.width and Panel.scale say the same thing"),
    (lambda: Sensor(pitch=2.0, scale=3.0), "Sensor.pitch and Sensor.scale say the same thing"),
    (lambda: Panel(width=(0.0, 100.0)), "Panel.width must be at least 1"),
    (lambda: Sensor(pitch=(0.0, 2.0)), "Sensor.pitch must be at least 0.001"),
    (lambda: Sensor(reading="bined"), "Did you mean 'binned'"),
    (lambda: Scene(panel=RANGED, sensor=FULL), "a full reading has one number of sensor pixels"),
    (lambda: Scene(sensor=Sensor(pitch=2.0, reading="full")), "Sensor.pitch = 2.0 does not fix."),
    (lambda: Scene(panel=FIXED, sensor=Sensor(exposure="point")), "or 'mean'; got 'point'"),
    (lambda: Scene(panel=FIXED, develop=Develop(demosaic="malvar")), "must be 'bilinear'"),
    (lambda: Scene(panel=FIXED, develop=Develop(denoise="nlm")), "Develop.denoise"),
    (lambda: Scene(panel=Panel(width=1.0)).plan((10, 8192)), "at least 1.6384 panel pixels for"),
]


@pytest.mark.parametrize(("make", "sentence"), SENTENCES, ids=range(len(SENTENCES)))
def test_what_says_two_things_gets_a_sentence(make, sentence):
    with pytest.raises(ValueError, match=re.escape(sentence)):
        make()


def test_a_reading_is_binned_where_a_screen_is_stated():
    assert not Scene().is_binned
    assert Scene(panel=Panel(width=200.0)).is_binned and Scene(sensor=Sensor(pitch=2.0)).is_binned
    assert all(Scene.preset(name).is_binned != name.startswith("paper") for name in PRESETS)
    full = Scene(panel=Panel(width=200.0), sensor=Sensor(scale=2.0, reading="full"))
    assert not full.is_binned
    shot = full.sample(1, (10, 20))
    assert shot.raw_shape() == (1, 4, 10, 20) and shot.panel_scale.tolist() == [10.0]


def test_a_plan_is_that_of_a_size():
    small, large = SCREEN.plan((48, 48)), SCREEN.plan((2000, 1500))
    assert "in bins of 4.1 sensor pixels" in str(small)
    assert "in bins of 0.13 sensor pixels" in str(large)
    assert "binned" in str(small) and SCREEN.plan((40, 33)).steps == small.steps  # same octave
    stamp = Scene()
    assert stamp.plan_effects((5, 5)) is stamp.plan_effects((999, 3))


def test_the_engine_sums_the_harmonics_of_the_pictures_size():
    """Of a full reading of a screen, seen closer in a large picture than in a small one."""
    parts = {"lens": Lens(blur=0.25), "sensor": Sensor(scale=2.0, reading="full")}
    full = Scene(panel=Panel(width=40.0), view=View(yaw=10.0, roll=3.0), **parts)
    assert len(full.plan((300, 200)).harmonics) > len(full.plan().harmonics)
    assert_equal(*readings(full, (300, 200), n=1))


def test_contrast_is_judged_in_the_photo():
    """Harmonics that every bin averages away are left out, within the tolerance."""
    panel = Panel(width=800.0, lit_y=0.6)
    screen = Scene(panel=panel, lens=Lens(blur=0.3), sensor=Sensor(pitch=2.6))
    planned = screen.plan((64, 64)).harmonics
    at_sensor = extreme_readings.harmonics(scene_of_size(screen, (64, 64)))
    assert 0 < len(planned) < len(at_sensor)
    grey = torch.full((1, 3, 64, 64), 0.7, dtype=torch.float64)
    exact = dataclasses.replace(screen, tolerance=1e-6)
    difference = [pipeline.expose(grey, one.sample(1, (64, 64))) for one in (screen, exact)]
    assert (difference[0] - difference[1]).abs().max() < 2 * screen.tolerance
    # sensor pixels that saturate do so by what is averaged away, too
    bright = dataclasses.replace(screen, sensor=Sensor(pitch=2.6, gain=2.0))
    assert len(bright.plan((64, 64)).harmonics) >= len(at_sensor)
    dim, lamp = Sensor(pitch=2.6, gain=0.95), dataclasses.replace(panel, glare=0.3)
    dark = dataclasses.replace(screen, sensor=dim)
    glaring = dataclasses.replace(dark, panel=lamp)
    assert "saturate" not in dark.plan() and "saturate" in glaring.plan()
    assert len(dark.plan((64, 64)).harmonics) < len(glaring.plan((64, 64)).harmonics)


def before_and_after(scene):
    """The moiré, as photo less twin, of photos (4, 3, 48, 64): taken of a picture twice as large
    and then made smaller, and taken of the picture made smaller first."""
    smooth = torch.rand(4, 3, 3, 4, generator=torch.Generator().manual_seed(3))
    large = F.interpolate(smooth, (96, 128), mode="bicubic").clamp(0, 1)
    shot = scene.sample(4, (96, 128), torch.Generator().manual_seed(4))
    small = dataclasses.replace(shot, size=(48, 64))
    found = []
    for one, picture in ((shot, large), (small, F.interpolate(large, (48, 64), mode="area"))):
        with backends.reference():
            moire = capture(picture, one) - capture(picture, without_moire(one))
        found.append(F.interpolate(moire, (48, 64), mode="area"))
    return found


def test_a_transform_may_stand_before_or_after_a_resize():
    """In the camera's frame, the moiré of each pixel is the same. Warped back to the image's, which
    a small photo is by coarser pixels, it is as strong within a fifth."""
    after, before = before_and_after(dataclasses.replace(SCREEN, develop=Develop(registered=False)))
    assert rms(after - before) < 0.004 and rms(after - before) < rms(before) / 8
    after, before = before_and_after(SCREEN)
    assert rms(after) == pytest.approx(rms(before), rel=0.2)


def test_a_panel_tied_to_pixels_differs_after_a_resize():
    """A negative control: tied to the picture's pixels, the moiré is another one."""
    sensor = Sensor(scale=2.0, reading="binned")
    stamp = dataclasses.replace(SCREEN, panel=Panel(scale=1.1), sensor=sensor)
    stamp = dataclasses.replace(stamp, develop=Develop(registered=False))
    after, before = before_and_after(stamp)
    assert rms(after - before) > rms(before) / 2


HARD = {
    "a hundredth of a sensor pixel": (Panel(width=1.0), Sensor(pitch=1.0), View(), (100, 100)),
    "150 sensor pixels": (Panel(width=600.0), Sensor(pitch=2.0), View(roll=3.0), (8, 8)),
    "a pixel": (Panel(width=1600.0), Sensor(pitch=2.2), View(yaw=20.0), (1, 1)),
    "a row": (Panel(width=800.0), Sensor(pitch=2.2), View(yaw=20.0), (1, 300)),
    "a small screen": (Panel(width=12.0), Sensor(pitch=1.7), View(roll=4.0), (64, 48)),
    "a beat of frequency zero": (Panel(width=200.0), Sensor(pitch=2.0), View(), (40, 40)),
    "grazing": (Panel(width=400.0), Sensor(pitch=2.0), View(yaw=80.0), (40, 40)),
    "horizon": (Panel(width=300.0), Sensor(pitch=2.0), View(pitch=85.0, fit=False), (40, 40)),
    "turned over": (Panel(width=300.0), Sensor(pitch=2.0), View(roll=90.0), (40, 30)),
    "far away": (Panel(width=300.0), Sensor(pitch=2.0), View(zoom=0.02, fit=False), (40, 40)),
    "a pitch of a thousand": (Panel(width=3.0), Sensor(pitch=1000.0), View(roll=1.0), (20, 20)),
    "a pitch of a thousandth": (Panel(width=5000.0), Sensor(pitch=1e-3), View(), (20, 20)),
}


@pytest.mark.parametrize(("panel", "sensor", "view", "size"), HARD.values(), ids=HARD)
def test_hard_cases_are_finite_and_near_their_float64_answer(panel, sensor, view, size):
    scene = Scene(panel=panel, sensor=sensor, view=view, lens=Lens(blur=0.3))
    shot = scene.sample(1, size, torch.Generator().manual_seed(0))
    picture = torch.rand(1, 3, *size, generator=torch.Generator().manual_seed(1))
    exact = pipeline.expose(picture.double(), shot)
    assert exact.isfinite().all() and exact.min() > -3e-3 and exact.max() < 1.2
    shown = pixels_on_photo(shot)[1][:, None] if scene.is_rectified else 1
    assert rms((expose(picture, shot) - exact) * shown) < 1e-3
    assert capture(picture, shot).isfinite().all()


def test_a_value_averages_the_pixels_of_its_colour():
    scale = torch.tensor([0.01, 0.5, 2.0, 3.0, 150.0])
    counts = pixels_per_value(SCREEN.sample(5, (8, 8)), scale)
    assert counts.tolist() == pytest.approx((scale**2 / 4).clamp(min=1).tolist())


def test_a_colour_that_a_panel_lacks_is_dark_in_bins():
    red = Layout(((0, 0, 0, 1, 1),))
    shot = dataclasses.replace(SCREEN, panel=Panel(width=100.0, layout=red)).sample(1, (12, 12))
    raw = expose(torch.ones(1, 3, 12, 12), shot)
    assert raw[:, 1:].abs().max() < 1e-6 and raw[:, 0].min() > 0.1
