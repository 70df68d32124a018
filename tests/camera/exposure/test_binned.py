"""Binned readings: the photo of a full reading, and beats of the period, strength and colour that
follow from the pitch."""

import math

import numpy as np
import pytest
import torch

from moireaug import Develop, Lens, Panel, Scene, Sensor, View, capture, expose
from moireaug.camera import pipeline
from moireaug.common import tensor_physics
from moireaug.engine import backends
from moireaug.scene.by_name import with_values
from moireaug.scene.fields import bounds
from moireaug.synthesis import without_moire
from tests.engine.readings import assert_equal, readings

TURNED = View(yaw=15.0, pitch=8.0, roll=3.0)
SOFT = Lens(blur=0.4)


def picture(h, w):
    """A smooth picture with an edge, as pictures are."""
    y, x = torch.meshgrid(torch.linspace(0, 1, h), torch.linspace(0, 1, w), indexing="ij")
    waves = [torch.sin(2 * math.pi * (c + 1.5) * x + c) * torch.cos(5 * y - c) for c in range(3)]
    shown = 0.5 + 0.4 * torch.stack(waves)
    shown[:, h // 3 : h // 2, w // 4 : w // 2] = torch.tensor([0.9, 0.2, 0.4])[:, None, None]
    return shown[None]


def photo(reading, *, panel, sensor, view=TURNED, develop=None, lens=SOFT):
    sensor = Sensor(reading=reading, **sensor)
    develop = develop or Develop(registered=False)
    scene = Scene(panel=panel, view=view, lens=lens, sensor=sensor, develop=develop)
    shot, shown = scene.sample(1, (40, 48), torch.Generator().manual_seed(0)), picture(40, 48)
    inner = (..., slice(8, -8), slice(8, -8))  # the picture's dark surroundings are left out
    return capture(shown, shot)[inner], capture(shown, without_moire(shot))[inner]


def rms(difference):
    return float(difference.square().mean().sqrt())


FOUR = {"panel": Panel(scale=2.1), "sensor": {"scale": 4.0}}
CASES = {
    "two": {"panel": Panel(scale=1.05), "sensor": {"scale": 2.0}},
    "two and a half": {"panel": Panel(scale=1.2), "sensor": {"scale": 2.5}},
    "nine, matrix": {"panel": Panel(scale=4.2, lit_y=0.6), "sensor": {"scale": 9.0}},
    "frontal": FOUR | {"view": View()},
    "crosstalk": {"panel": Panel(scale=1.9), "sensor": {"scale": 4.0, "crosstalk": 0.2}},
    "chevron": {"panel": Panel(scale=1.9, layout="chevron"), "sensor": {"scale": 4.0}},
    "no colour filters": {"panel": Panel(scale=3.1), "sensor": {"scale": 3.0, "cfa": "none"}},
    "coarse panel": {"panel": Panel(scale=0.45), "sensor": {"scale": 1.0}},
    "registered": FOUR | {"view": View(), "develop": Develop()},
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_a_binned_photo_is_the_full_one(case):
    full, twin = photo("full", **case)
    binned, _ = photo("binned", **case)
    assert rms(binned - full) < 0.01
    assert rms(full - twin) > 2 * rms(binned - full)  # a negative control: there is moiré to miss


VIEWS = {
    "rolled far": {"view": View(roll=40.0)},
    "bent": {"view": TURNED, "lens": Lens(blur=0.4, k1=-0.06, k2=0.02)},
    "moved": {"view": View(yaw=10.0, zoom=1.1, shift_x=0.03)},
    "vignetting, flicker, glare": {
        "view": View(yaw=12.0, roll=4.0),
        "lens": Lens(blur=0.4, vignetting=0.4),
        "panel": {"pwm": 240.0, "glare": 0.05, "glare_x": 0.5},
        "sensor": {"shutter": 0.002, "readout": 0.03},
    },
}


@pytest.mark.parametrize("case", VIEWS.values(), ids=VIEWS)
def test_bins_in_the_images_frame_are_a_large_photo_registered_and_shrunk(case):
    """The picture enlarged k times, so that a photo pixel of the full reading is a sensor pixel;
    its photo registered there, and then averaged over k x k pixels."""
    k, size, panel, sensor = 6, (24, 30), case.get("panel", {}), case.get("sensor", {})
    shown = picture(*size).double()
    large = torch.nn.functional.interpolate(shown, scale_factor=k, mode="nearest")
    common = {"view": case["view"], "lens": case.get("lens", SOFT)}
    both = []
    for reading, scale, image in (("full", 1, large), ("binned", k, shown)):
        parts = common | {"panel": Panel(scale=0.5 * scale, **panel)}
        scene = Scene(sensor=Sensor(scale=float(scale), reading=reading, **sensor), **parts)
        shot = scene.sample(1, tuple(image.shape[-2:]), torch.Generator().manual_seed(0))
        twin = pipeline.expose(image, without_moire(shot))
        both.append([pipeline.develop(raw, shot) for raw in (pipeline.expose(image, shot), twin)])
    registered = [torch.nn.functional.avg_pool2d(photo, k) for photo in both[0]]
    inner = (..., slice(2, -2), slice(2, -2))
    moire = [(photo - twin)[inner] for photo, twin in (registered, both[1])]
    assert rms(moire[0]) > 2 * rms(moire[1] - moire[0])  # a negative control
    assert rms(moire[1] - moire[0]) < 0.008
    assert rms((both[1][1] - registered[1])[inner]) < 0.03  # the picture, shown another way


def test_a_saturated_binned_photo_is_nearly_the_full_one(monkeypatch):
    """Sensor pixels saturate one by one: the mean of clipped pixels is not their mean clipped."""
    case = {"panel": Panel(scale=3.3), "sensor": {"scale": 8.0, "gain": 3.0}}
    with backends.reference():
        full, _ = photo("full", **case)
        binned, _ = photo("binned", **case)
        clip = tensor_physics.clipping
        monkeypatch.setattr(clip, "expected_clip", lambda raw, noise, pattern: raw.clamp(0, 1))
        naive, _ = photo("binned", **case)
    assert rms(binned - full) < 0.013 and rms(binned - full) < 0.6 * rms(naive - full)


@pytest.mark.parametrize("gain", [3.0, 1000.0])
def test_a_saturated_sparse_panel_is_neither_black_nor_too_bright(gain):
    """Light of two levels is the extreme: no light of a pattern, clipped, is darker."""
    panel = Panel(layout="led", width=32.0, lit=0.4)
    scene = Scene(panel=panel, sensor=Sensor(pitch=8.0, gain=gain))
    shot, white = scene.sample(1, (16, 16)), torch.ones(1, 3, 16, 16)
    reading = expose(white, shot)
    assert rms(reading - pipeline.expose(white, shot)) < 1e-6
    assert reading.min() > 0.03 and reading.max() < 0.2


def test_clipped_light_of_two_levels_is_exact():
    mean, level = torch.tensor([0.2, 0.9, 2.0]).double(), torch.tensor([3.0, 9.0, 40.0]).double()
    variance = mean * level - mean.square()
    none = torch.zeros_like(mean)
    bound = mean - tensor_physics.clipping.greatest_excess(mean, none, variance)
    assert torch.allclose(bound, mean / level)
    assert (tensor_physics.clipping.expected_clip(mean, none, variance) >= bound - 1e-12).all()


def test_one_camera_stated_in_two_ways_sees_the_same():
    panel, white = Panel(width=516.0, lit_y=0.5), torch.ones(1, 3, 64, 64)
    full = Scene(panel=panel, sensor=Sensor(scale=16.0, reading="full")).capture(white)
    for sensor in (Sensor(scale=16.0), Sensor(pitch=16 * 64 / 516)):
        assert rms(Scene(panel=panel, sensor=sensor).capture(white) - full) < 0.003


def test_a_pattern_is_never_darker_than_black():
    """Noise is clipped at 0, and lightens the dark; a panel's pattern is light, and does not."""
    raw = torch.tensor([0.0, 0.01, 0.1], dtype=torch.float64)
    none = torch.zeros_like(raw)
    assert torch.allclose(tensor_physics.clipping.expected_clip(raw, none, raw.square()), raw)
    noisy = tensor_physics.clipping.expected_clip(raw, none + 1e-4, none)
    drawn = raw + 0.01 * torch.randn(200_000, 1, dtype=torch.float64)
    assert torch.allclose(noisy, drawn.clamp(0, 1).mean(0), atol=2e-4) and noisy[0] > 0.003


@pytest.mark.parametrize("pitch", [2.1, 1.9, 2.3])
def test_beats_have_the_period_strength_and_colour_of_their_pitch(pitch):
    """A white stripe panel seen head-on: its first harmonic, 1 / pitch cycles per sensor pixel, is
    seen at g = 1 / pitch - 1 / 2 by red and blue, which read every second pixel, and not at all by
    green, whose pixels lie on a quincunx."""
    s, w = 4.0, 400
    scene = Scene(panel=Panel(scale=s / pitch), lens=SOFT, sensor=Sensor(scale=s, reading="binned"))
    shot = scene.sample(1, (3, w))
    raw = pipeline.expose(torch.ones(1, 3, 3, w, dtype=torch.float64), shot)[0, :, 1]
    f, g = 1 / pitch, 1 / pitch - 0.5
    u = (torch.arange(w, dtype=torch.float64) + 0.5) * s
    window = torch.hann_window(w, periodic=False, dtype=torch.float64)
    beat = torch.exp(-2j * math.pi * g * u) * window
    swing = raw - raw.mean(1, keepdim=True)
    red, green, blue = (2 * (beat * swing[i]).sum() / window.sum() for i in (0, 1, 3))

    first = math.sin(math.pi / 3) / math.pi  # of a stripe a third of a pixel wide
    passed = np.sinc(f) * math.exp(-2 * math.pi**2 * 0.4**2 * f**2)
    left = math.cos(math.pi * g) ** 2 * np.sinc(g) * np.sinc(s * g)
    assert float(red.abs()) == pytest.approx(2 * first * passed * left, rel=0.03)
    assert float(blue.abs()) == pytest.approx(float(red.abs()), rel=0.03)
    assert green.abs() < 0.1 * red.abs()  # what is left of the first harmonic itself
    # red stripes lie a third of a pixel before green ones, blue a third behind; blue pixels read
    # one pixel later than red ones, which is half a turn of an alias of half a cycle per pixel
    turn = 2 * math.pi * (1 / 6 - 5 / 6) + math.pi
    assert torch.exp(1j * (blue.angle() - red.angle() - turn)).real > 0.999


ENGINE = {
    "screen": {"panel": Panel(width=(300.0, 500.0), lit_y=0.7)},
    "fine screen": {"panel": Panel(width=1600.0)},
    "LED wall": {"panel": Panel(width=(20.0, 60.0), layout="led", lit=0.5)},
    "PenTile": {"panel": Panel(width=300.0, layout="pentile_diamond", lit=0.6)},
    "camera's frame": {"panel": Panel(width=200.0), "develop": Develop(registered=False)},
    "light": {"panel": Panel(width=200.0), "develop": Develop(linear_light=True)},
    "antialiased": {"panel": Panel(width=(20.0, 200.0)), "develop": Develop(resize="antialias")},
    "sampled": {"panel": Panel(width=(60.0, 200.0)), "develop": Develop(resize="point")},
}
SENSORS = {
    "Bayer": Sensor(pitch=(1.6, 2.4)),
    "no colour filters": Sensor(pitch=(0.8, 1.2), cfa="none"),
    "noise": Sensor(pitch=2.0, gain=2.0, read_noise=0.02, shot_noise=0.03, crosstalk=0.2),
}
BENT = Lens(k1=(-0.03, 0.05), blur=(0.3, 0.6), motion_x=(-0.3, 0.3), olpf=(0.0, 0.5))
MOVED = View(yaw=(-25.0, 25.0), pitch=(-15.0, 15.0), roll=(-12.0, 12.0))


@pytest.mark.parametrize("sensor", SENSORS.values(), ids=SENSORS)
@pytest.mark.parametrize("case", ENGINE.values(), ids=ENGINE)
def test_the_engine_reads_bins_as_the_reference_does(case, sensor):
    scene = Scene(view=MOVED, lens=BENT, sensor=sensor, **case)
    gain = max(bounds(scene.sensor.gain)[1], 1.0)
    assert_equal(*(reading / gain for reading in readings(scene, (37, 52))))


@pytest.mark.parametrize("scale", [3.0, 4.0])
def test_a_sampled_photo_is_that_of_a_full_reading(scale):
    """Of which two sensor pixels, or one, are taken in the middle of each photo pixel."""
    full = Scene(
        panel=Panel(scale=scale / 2.1, lit_y=0.6), lens=Lens(blur=0.35),
        view=View(roll=3.0, fit=False),
        sensor=Sensor(scale=scale), develop=Develop(resize="point", registered=False),
    )  # fmt: skip
    binned = with_values(full, {"sensor.reading": "binned"})
    averaged = with_values(binned, {"develop.resize": "area"})
    grey = torch.full((1, 3, 40, 40), 0.5, dtype=torch.float64)
    photos = []
    for scene in (full, binned, averaged):
        photos.append(capture(grey, scene.sample(1, (40, 40)))[..., 6:-6, 6:-6])
    expected, photo, other = photos
    assert expected.std() > 0.02
    assert rms(photo - expected) < 0.1 * expected.std()
    assert rms(other - expected) > 2 * rms(photo - expected)


def test_noise_is_that_of_the_pixels_that_a_bin_averages():
    scene = Scene(panel=Panel(layout="even"), sensor=Sensor(scale=8.0, read_noise=0.1, gain=0.5))
    binned = with_values(scene, {"sensor.reading": "binned"})
    grey = torch.full((4, 3, 64, 64), 0.9)
    raw = expose(grey, binned.sample(4, (64, 64)))
    assert raw.std(dim=(2, 3)).mean() == pytest.approx(0.1 / 4, rel=0.02)  # 16 pixels of a colour
    full = expose(grey, scene.sample(4, (64, 64)))
    means = torch.nn.functional.avg_pool2d(full, 4)  # 4 x 4 pixels of a colour are a photo pixel
    assert means.std(dim=(2, 3)).mean() == pytest.approx(0.1 / 4, rel=0.02)


def test_pulses_that_fill_the_wells_darken_a_binned_reading_as_a_full_one():
    """At a gain of 1, which a panel without pulses leaves below a full well."""
    scene = Scene(
        panel=Panel(scale=24.0, pwm=200.0, duty=0.4, phase=0.0),
        lens=Lens(blur=0.5),
        sensor=Sensor(scale=60.0, cfa="none", shutter=0.001, readout=0.01),
        tolerance=0.01,
    )
    white, means = torch.ones(1, 3, 8, 8), {}
    for reading in ("full", "binned"):
        shot = with_values(scene, {"sensor.reading": reading}).sample(1, (8, 8))
        means[reading] = pipeline.expose(white, shot).mean().item()
    assert means["binned"] == pytest.approx(means["full"], abs=0.005)
    assert means["full"] < 1 / 3 - 0.015  # of the panel's light


BESIDE = {
    "dark": {},
    "glare": {"panel": Panel(width=64.0, glare=1.0, glare_x=0.5)},
    "lens": {"lens": Lens(blur=0.5, vignetting=0.6, k1=0.1, k2=-0.05)},
}


@pytest.mark.parametrize("case", BESIDE.values(), ids=BESIDE)
def test_sharpening_spreads_what_the_reference_reads_beside_the_photo(case):
    parts = {"panel": Panel(width=64.0), "lens": Lens(blur=0.5, vignetting=0.6)} | case
    scene = Scene(
        view=View(shift_x=0.4, zoom=1.5),
        sensor=Sensor(pitch=0.5),
        develop=Develop(sharpen=2.0, sharpen_radius=3.0),
        **parts,
    )
    shot, shown = scene.sample(1, (32, 32)), picture(32, 32)
    expected = pipeline.develop(pipeline.expose(shown.double(), shot), shot)
    assert_equal(capture(shown, shot), expected)


def test_flicker_of_a_cycle_a_row_is_read_as_the_reference_does():
    scene = Scene(
        panel=Panel(width=200.0, pwm=1200.0, duty=0.6),
        view=View(yaw=30.0),
        lens=SOFT,
        sensor=Sensor(pitch=3.0, shutter=5e-4, readout=0.02, exposure="mean"),
    )
    assert_equal(*readings(scene, (24, 24)))
