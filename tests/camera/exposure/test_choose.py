"""The choice of method, harmonics and taps by a scene's ranges."""

import dataclasses

import pytest
import torch

from benchmarks import problems
from moireaug import Lens, Panel, Scene, Sensor, View, expose
from moireaug.camera.exposure.choose import MAX_HARMONICS
from moireaug.camera.exposure.extreme_readings import harmonics_in_bins
from moireaug.scene.by_name import with_values
from moireaug.scene.sized import scene_of_size

TAPS = [  # scene, panel pixels along an axis that a sensor pixel sees
    (Scene(panel=Panel(scale=0.1, layout="led")), 1),
    (Scene(panel=Panel(scale=0.1)), 3),
    (Scene(), 3),
    (Scene(panel=Panel(scale=3.0)), 5),
    (Scene(lens=Lens(blur=0.8)), 5),
    (Scene(panel=Panel(scale=0.1), lens=Lens(blur=(0.0, 8.0))), 3),
    (Scene(view=View(zoom=(0.02, 1.0))), 7),
    (Scene(panel=Panel(scale=3.0, layout="pentile")), 5),
]


def test_taps_are_as_many_as_are_seen():
    for scene, taps in TAPS:
        assert scene.plan().method.taps == taps, scene


def error(problem, fewer, more):
    """Return the error of what "auto" chooses against brute force: root mean square of the raw
    reading, in per cent.

    Brute force has an error of its own, another one for each number of points: it cancels in the
    product of the distances from two of them.
    """
    side = problem.side(16)
    image = problems.images(problem.picture, 1, side).double()
    shot = problem.scene.sample(1, (side, side), torch.Generator().manual_seed(0))
    ours, distances = expose(image, shot), []
    for n in (fewer, more):
        scene = with_values(problem.scene, {"sensor.exposure": f"supersample:{n}"})
        brute = expose(image, dataclasses.replace(shot, scene=scene))
        distances.append((ours - brute) / brute.square().mean().sqrt())
    return 100 * float((distances[0] * distances[1]).mean().clamp(min=0).sqrt())


@pytest.mark.parametrize(
    "given",
    problems.PROBLEMS,
    ids=lambda g: f"{g['picture']}-{g['layout']}-{g['pitch']}-{g['view']}",
)
def test_auto_is_within_a_per_cent_of_brute_force(given):
    small = given["layout"] == "led" or given["pitch"] < 1  # subpixels are hit by few points
    points = (17, 32) if small else (13, 21)
    assert error(problems.problem(**given), *points) < 1.0


def test_another_exposure_is_not():
    given = problems.problem(**problems.PROBLEMS[6])
    mean = with_values(given.scene, {"sensor.exposure": "mean"})
    assert error(dataclasses.replace(given, scene=mean), 13, 21) > 5


def test_a_plan_says_which_harmonics_are_too_many():
    scene = Scene(panel=Panel(lit=0.5, width=20.0), sensor=Sensor(pitch=60.0, gain=10.0))
    possible, summed = harmonics_in_bins(scene_of_size(scene)), scene.plan().harmonics
    assert summed == tuple(pair for pair, _ in possible[:MAX_HARMONICS])
    left_out, strength = len(possible) - len(summed), possible[len(summed)][1]
    reason = f"; {left_out} weaker ones, up to {strength:.2g}, are too many to sum"
    assert left_out > 0 and reason in str(scene.plan())
    assert "weaker" not in str(Scene(panel=Panel(width=20.0), sensor=Sensor(pitch=20.0)).plan())


@pytest.mark.parametrize("layout", ["chevron", "pentile_diamond"])
def test_slanted_subpixels_are_never_taken_for_boxes(layout):
    scene = Scene(panel=Panel(layout=layout, scale=0.03), sensor=Sensor(scale=2, cfa="none"))
    assert scene.plan().exposure == "spectral"
    readings = []
    for exposure in ("auto", "supersample:8"):
        shot = with_values(scene, {"sensor.exposure": exposure}).sample(1, (24, 24))
        readings.append(expose(torch.ones(1, 3, 24, 24), shot))
    apart = (readings[0] - readings[1]).square().mean().sqrt()
    assert apart < 0.15 * readings[1].mean()  # a box is off by 0.78 and 1.4
    for exposure in ("box", "point"):
        refused = with_values(scene, {"sensor.exposure": exposure})
        for use in (refused.plan, lambda of=refused: of.sample(1, (4, 4))):
            with pytest.raises(ValueError, match=f"'{exposure}' takes subpixels for rectangles"):
                use()
