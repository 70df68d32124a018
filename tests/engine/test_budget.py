"""The engine's errors follow the scene's tolerance."""

import dataclasses

import pytest
import torch

from moireaug import Scene
from moireaug.camera import pipeline
from moireaug.engine.cpu import run
from moireaug.engine.lower.budget import MAX_TOLERANCE, MIN_TOLERANCE, ErrorBudget
from moireaug.engine.lower.exposure import lower_exposure
from moireaug.scene.by_name import with_values
from tests.engine import scenes
from tests.engine.readings import readings

SCENES = {
    "full readings": scenes.SCENES["bent"],
    "motion": with_values(scenes.SCENES["bent"], {"lens.motion_x": 2.0}),
    "bins": Scene.preset("phone_at_monitor"),
    "bins of the picture": with_values(Scene.preset("screen_photo"), {"sensor.gain": (1.5, 3.0)}),
}
SIZE = (40, 52)
DEFAULT = Scene().tolerance


def test_the_default_budget_and_its_limits():
    budget = ErrorBudget.of(DEFAULT)
    assert budget.harmonic_amplitude == 2e-5 and budget.beat_cycles == 0.2
    assert ErrorBudget.of(0.0) == ErrorBudget.of(MIN_TOLERANCE)
    assert ErrorBudget.of(1.0) == ErrorBudget.of(MAX_TOLERANCE)


@pytest.mark.parametrize("tolerance", [MAX_TOLERANCE, DEFAULT / 8, MIN_TOLERANCE])
@pytest.mark.parametrize("name", SCENES)
def test_readings_are_within_the_tolerance(name, tolerance):
    scene = dataclasses.replace(SCENES[name], tolerance=tolerance)
    got, expected = readings(scene, SIZE)
    assert (got - expected).abs().max() < tolerance


def reading_differences(name):
    """Return the differences of one shot's readings from the reference in float64, by the tolerance
    of their budget."""
    shot = SCENES[name].sample(2, SIZE, torch.Generator().manual_seed(3))
    images = torch.rand(2, 3, *SIZE, generator=torch.Generator().manual_seed(4))
    expected, differences = pipeline.expose(images.double(), shot), {}
    exposure, view = lower_exposure(shot, decoded=False)
    for tolerance in (MAX_TOLERANCE, DEFAULT, DEFAULT / 8):
        lowered = exposure._replace(budget=ErrorBudget.of(tolerance))
        read, _ = run.launch_expose(images, False, lowered, view)
        differences[tolerance] = read.double() - expected
    return differences


@pytest.mark.parametrize("name", SCENES)
def test_a_tighter_budget_is_closer_to_the_reference(name):
    differences = reading_differences(name)
    loose, default, tight = (d.square().mean().sqrt() for d in differences.values())
    assert tight < default < loose and tight < loose / 3
    if name == "full readings":  # negative control: a loose budget misses a tight tolerance
        assert differences[MAX_TOLERANCE].abs().max() > DEFAULT / 8
