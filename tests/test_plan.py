"""Plan: an effect at its identity, or below the tolerance, is absent; the rest say why they are there."""

import dataclasses

import pytest
import torch

from moireaug import Develop, Lens, Panel, Scene, Sensor, View, capture
from moireaug.presets import PRESETS

BARE = Scene(lens=Lens(blur=3.0))  # so soft a lens that no stripe is left

CALLED = [
    ("decode", {"develop": Develop(linear_light=True)}),
    ("encode", {"develop": Develop(linear_light=True)}),
    ("layout", {"lens": Lens()}),
    ("panel", {"sensor": Sensor(exposure="point")}),
    ("pose", {"view": View(yaw=(0, 1))}),
    ("pose", {"view": View(zoom=0.9)}),
    ("pose", {"view": View(shift_x=0.1)}),
    ("lens", {"lens": Lens(k1=0.01, blur=3.0)}),
    ("gain", {"sensor": Sensor(gain=0.5)}),
    ("saturate", {"sensor": Sensor(gain=(0.5, 1.5))}),
    ("read_noise", {"sensor": Sensor(read_noise=(0, 0.1))}),
    ("resize", {"sensor": Sensor(scale=2)}),
    ("brighten", {"develop": Develop(brighten=0.1)}),
    ("register", {"view": View(roll=5)}),
]


@pytest.mark.parametrize(("effect", "change"), CALLED)
def test_an_effect_is_there_when_and_only_when_called_for(effect, change):
    assert effect not in BARE.plan()
    scene = dataclasses.replace(BARE, **change)
    assert effect in scene.plan()
    reasons = scene.plan().to_dict()
    assert reasons["effects"][effect] and effect not in reasons["left_out"]


@pytest.mark.parametrize("name", PRESETS)
def test_a_plan_prints_every_effect_once_with_its_reason(name):
    plan = Scene.preset(name).plan()
    lines = str(plan).splitlines()
    for step in plan.steps:
        assert step.reason
        assert sum(line[4:].strip().startswith(step.effect + " ") for line in lines) == 1


def test_harmonics_below_the_tolerance_change_nothing_above_it(images):
    """Dropping what the plan drops moves no pixel of the raw reading by more than the sum that was dropped."""
    base = Scene(panel=Panel(scale=(0.8, 1.6)), view=View(roll=(-20, 20)), lens=Lens(blur=0.25), sensor=Sensor(scale=2))
    shot = base.sample(4, (24, 32))
    exact = dataclasses.replace(base, tolerance=1e-7)
    assert len(exact.plan().harmonics) > len(base.plan().harmonics) > 0
    difference = capture(images, shot) - capture(images, dataclasses.replace(shot, scene=exact))
    assert 0 < difference.abs().max() < 4 * base.tolerance


def test_a_loose_tolerance_drops_the_moire():
    """Negative control: the bound above is not met when real contrast is dropped."""
    base = Scene(panel=Panel(scale=1.0), lens=Lens(blur=0.25), sensor=Sensor(scale=2))
    shot, flat = base.sample(1, (24, 32)), torch.full((1, 3, 24, 32), 0.9)
    loose = dataclasses.replace(base, tolerance=1.0)
    assert "layout" not in loose.plan()
    change = (capture(flat, shot) - capture(flat, dataclasses.replace(shot, scene=loose))).abs().max()
    assert change > 4 * base.tolerance


def test_auto_never_stays_auto():
    for scene in (Scene(), Scene(panel=Panel(layout="led", lit=0.2), sensor=Sensor(scale=8))):
        assert scene.plan().exposure in ("spectral", "box")


def test_a_screen_magnified_beyond_the_series_is_integrated_in_closed_form():
    assert Scene(panel=Panel(scale=0.5), sensor=Sensor(scale=2)).plan().exposure == "spectral"  # pitch 4
    assert Scene(panel=Panel(scale=0.01), sensor=Sensor(scale=2)).plan().exposure == "box"  # pitch 200
