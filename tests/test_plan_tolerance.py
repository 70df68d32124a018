"""Plan: what is dropped for being below the tolerance changes no more than the tolerance."""

import dataclasses

import pytest
import torch

from moireaug import Develop, Lens, Panel, Scene, Sensor, View, capture, expose
from moireaug.camera.effects.light import flicker
from tests.test_plan import BARE, colour, even

PULSED = even(pwm=1000.0, duty=0.5)
BRIGHT = PULSED | {"sensor": colour(shutter=0.3, readout=0.03)}
BANDS = PULSED | {"sensor": colour(shutter=0.0012, readout=0.03)}
LIGHT = {"develop": Develop(linear_light=True)}  # in the dark, a little of it is many codes
DROPPED = [  # effect, too small to matter, and not so
    ("black_level", even(black=0.0019), even(black=0.2)),
    ("glare", even(glare=0.001, glare_x=0.5, glare_y=-0.45), even(glare=0.2)),
    ("exposure", {"lens": Lens(blur=0.0012)}, {"lens": Lens(blur=0.5)}),
    ("exposure", {"lens": Lens(olpf=0.0024)}, {"lens": Lens(olpf=0.5)}),
    ("exposure", LIGHT | {"lens": Lens(blur=9e-5)}, LIGHT | {"lens": Lens(blur=0.04)}),
    # a little more than the seven pixels in view
    ("prefilter", {"view": View(zoom=0.16664, fit=False)}, {"view": View(zoom=0.155, fit=False)}),
    ("vignetting", {"lens": Lens(vignetting=0.0019)}, {"lens": Lens(vignetting=0.3)}),
    ("flicker", BRIGHT, BANDS),
    ("gain", {"sensor": colour(gain=0.9981)}, {"sensor": colour(gain=0.7)}),
    ("gain", {"sensor": colour(gain=1.0019)}, {"sensor": colour(gain=1.7)}),
    ("noise", {"sensor": colour(read_noise=0.0003)}, {"sensor": colour(read_noise=0.1)}),
    ("noise", {"sensor": colour(shot_noise=0.0003)}, {"sensor": colour(shot_noise=0.1)}),
    ("bits", {"sensor": colour(bits=9)}, {"sensor": colour(bits=2)}),
    ("noise", LIGHT | {"sensor": colour(read_noise=2e-5)}, {"sensor": colour(read_noise=0.1)}),
    ("bits", LIGHT | {"sensor": colour(bits=12)}, LIGHT | {"sensor": colour(bits=4)}),
    ("balance", {"develop": Develop(red=1.0019)}, {"develop": Develop(red=1.5)}),
    ("balance", {"develop": Develop(blue=0.9981)}, {"develop": Develop(blue=0.5)}),
    ("tone_curve", {"develop": Develop(contrast=-0.02)}, {"develop": Develop(contrast=1.0)}),
    ("tone_curve", {"develop": Develop(shoulder=0.007)}, {"develop": Develop(shoulder=2.0)}),
    ("sharpen", {"develop": Develop(sharpen=0.0019)}, {"develop": Develop(sharpen=0.9)}),
    ("brighten", {"develop": Develop(brighten=-0.0019)}, {"develop": Develop(brighten=-0.2)}),
]


def change_by_dropping(effect, scene, images):
    """How far the photo moves where the plan of `scene` leaves an effect out."""
    exact = dataclasses.replace(scene, tolerance=1e-9)
    assert effect not in scene.plan() and effect in exact.plan()
    shot = scene.sample(4, (24, 32), torch.Generator().manual_seed(0))
    change = capture(images, shot) - capture(images, dataclasses.replace(shot, scene=exact))
    return change.abs().max().item()


@pytest.mark.parametrize(("effect", "small", "large"), DROPPED)
def test_what_is_dropped_changes_nothing_by_more_than_the_tolerance(effect, small, large, images):
    image = (images > 0.5).double()  # black and white, where every effect is at its largest
    image[:2] = images[:2]
    scene = dataclasses.replace(BARE, **small)
    assert 0 < change_by_dropping(effect, scene, image) <= 1 / 512
    # and a tolerance that drops what does matter is noticed
    scene = dataclasses.replace(BARE, **large, tolerance=1.0)
    assert change_by_dropping(effect, scene, image) > 0.05


PULSES = [(0.5, 0.301), (0.5, 0.0012), (0.9985, 0.2), (0.1, 1e-4), (0.9985, 1e-4), (0.9985, 1e-6)]


@pytest.mark.parametrize(("duty", "shutter"), PULSES)
def test_flicker_is_left_out_only_where_rows_are_even(duty, shutter):
    scene = Scene(panel=Panel(pwm=1000.0, duty=duty), sensor=Sensor(shutter=shutter))
    one_cycle = torch.tensor([1000.0, duty, 0.0, shutter, 0.001], dtype=torch.float64)
    bands = flicker(torch.linspace(0, 1, 10001, dtype=torch.float64), *one_cycle[:, None])
    assert (bands - 1).abs().max() <= scene.tolerance or "flicker" in scene.plan()


def test_harmonics_below_the_tolerance_change_nothing_above_it(images):
    """Each dropped harmonic is below the tolerance. Their sum may exceed it: here it stays below
    four times as much."""
    parts = {"lens": Lens(blur=0.25), "sensor": Sensor(scale=2)}
    base = Scene(panel=Panel(scale=(0.8, 1.6)), view=View(roll=(-20, 20)), **parts)
    shot = base.sample(4, (24, 32))
    exact = dataclasses.replace(base, tolerance=1e-7)
    assert len(exact.plan().harmonics) > len(base.plan().harmonics) > 0
    difference = capture(images, shot) - capture(images, dataclasses.replace(shot, scene=exact))
    assert 0 < difference.abs().max() < 4 * base.tolerance


def test_harmonics_are_kept_that_only_the_photos_corners_show():
    """There a lens shows the panel largest, while a zoomed picture's own corners are out of
    sight."""
    parts = {"lens": Lens(k1=-0.3, blur=0.3), "sensor": colour(scale=2)}
    base = Scene(panel=Panel(scale=4.0), view=View(zoom=4.0, roll=3.0), **parts)
    shot, white = base.sample(1, (32, 32)), torch.ones(1, 3, 32, 32, dtype=torch.float64)
    exact = dataclasses.replace(shot, scene=dataclasses.replace(base, tolerance=1e-6))
    assert (expose(white, shot) - expose(white, exact)).abs().max() < 4 * base.tolerance


def test_a_loose_tolerance_drops_the_moire():
    """Negative control: the bound above is not met when real contrast is dropped."""
    base = Scene(panel=Panel(scale=1.0), lens=Lens(blur=0.25), sensor=Sensor(scale=2))
    shot, flat = base.sample(1, (24, 32)), torch.full((1, 3, 24, 32), 0.9)
    loose = dataclasses.replace(base, tolerance=1.0)
    assert "layout" not in loose.plan()
    change = capture(flat, shot) - capture(flat, dataclasses.replace(shot, scene=loose))
    assert change.abs().max() > 4 * base.tolerance
