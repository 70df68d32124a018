"""The engine's errors follow the scene's tolerance."""

import dataclasses

import pytest
import torch

from moireaug import Lens, Scene, Sensor, View, pipeline
from moireaug.engine.cpu import run
from moireaug.engine.lower.budget import MAX_TOLERANCE, MIN_TOLERANCE, ErrorBudget
from moireaug.engine.lower.exposure import lower_exposure
from tests.engine.readings import readings

TURNED = View(yaw=(-25.0, 25.0), pitch=(-15.0, 15.0), roll=(-12.0, 12.0), fov=(20.0, 50.0))
BENT = Lens(k1=(-0.03, 0.05), k2=(-0.02, 0.02), blur=(0.2, 0.4))
SCENES = {
    "full readings": Scene(view=TURNED, lens=BENT, sensor=Sensor(scale=2.0)),
    "motion": Scene(
        view=TURNED, lens=dataclasses.replace(BENT, motion_x=2.0), sensor=Sensor(scale=2.0)
    ),
    "bins": Scene.preset("phone_at_monitor"),
    "bins of the picture": Scene.preset("screen_photo"),
}
SIZE = (40, 52)
DEFAULT = Scene().tolerance


def test_the_default_budget():
    budget = ErrorBudget.of(DEFAULT)
    assert budget.harmonic_amplitude == 2e-5 and budget.beat_cycles == 0.2


def test_no_budget_is_beyond_the_limits():
    assert ErrorBudget.of(0.0) == ErrorBudget.of(MIN_TOLERANCE)
    assert ErrorBudget.of(1.0) == ErrorBudget.of(MAX_TOLERANCE)


@pytest.mark.parametrize("tolerance", [MAX_TOLERANCE, DEFAULT, DEFAULT / 8, MIN_TOLERANCE])
@pytest.mark.parametrize("name", SCENES)
def test_readings_are_within_the_tolerance(name, tolerance):
    scene = dataclasses.replace(SCENES[name], tolerance=tolerance)
    got, expected = readings(scene, SIZE)
    assert (got - expected).abs().max() < tolerance


def reading_errors(name):
    """Return how far readings of one shot are from the reference in float64, by the tolerance of
    their budget, root mean squares."""
    shot = SCENES[name].sample(2, SIZE, torch.Generator().manual_seed(3))
    images = torch.rand(2, 3, *SIZE, generator=torch.Generator().manual_seed(4))
    expected, errors = pipeline.expose(images.double(), shot), {}
    exposure, view = lower_exposure(shot, decoded=False)
    for tolerance in (MAX_TOLERANCE, DEFAULT, DEFAULT / 8):
        lowered = exposure._replace(budget=ErrorBudget.of(tolerance))
        difference = run.launch_expose(images, False, lowered, view)[0].double() - expected
        errors[tolerance] = float(difference.square().mean().sqrt())
    return errors


@pytest.mark.parametrize("name", SCENES)
def test_a_tighter_budget_is_closer_to_the_reference(name):
    errors = reading_errors(name)
    assert errors[DEFAULT / 8] < errors[DEFAULT] < errors[MAX_TOLERANCE]
    assert errors[DEFAULT / 8] < errors[MAX_TOLERANCE] / 3


def test_a_loose_budget_is_seen():
    """The negative control: readings of a tight scene with a loose budget are not within its
    tolerance."""
    shot = SCENES["full readings"].sample(2, SIZE, torch.Generator().manual_seed(3))
    images = torch.rand(2, 3, *SIZE, generator=torch.Generator().manual_seed(4))
    exposure, view = lower_exposure(shot, decoded=False)
    lowered = exposure._replace(budget=ErrorBudget.of(1.0))
    loose = run.launch_expose(images, False, lowered, view)[0]
    assert (loose.double() - pipeline.expose(images.double(), shot)).abs().max() > DEFAULT / 8
