"""Where the bins of a binned reading lie."""

import pytest
import torch

from moireaug import Develop, Lens, Panel, Scene, Sensor, View
from moireaug.camera.exposure.bin_geometry import middle_bins, pixels_on_photo
from moireaug.camera.exposure.extremes import least_bin_scale
from moireaug.scene.geometry import grids
from moireaug.scene.sized import scene_of_size

SCREEN = {"panel": Panel(width=200.0), "sensor": Sensor(pitch=2.0)}


def test_pixels_beside_the_photo_lie_at_its_nearest_edge():
    shot = Scene(**SCREEN, view=View(shift_x=0.25, shift_y=-0.5)).sample(1, (4, 8))
    points, shown = pixels_on_photo(shot)
    x = [2.5, 3.5, 4.5, 5.5, 6.5, 7.5, 8.0, 8.0]
    y = [0.0, 0.0, 0.5, 1.5]
    assert points[0, 0, :, 0].tolist() == pytest.approx(x)
    assert points[0, :, 0, 1].tolist() == pytest.approx(y)
    assert shown[0].tolist() == [[False] * 8] * 2 + [[True] * 6 + [False] * 2] * 2


def test_pixels_behind_the_camera_have_finite_bins():
    view = View(yaw=88.0, fov=89.0, fit=False)
    points, shown = pixels_on_photo(Scene(**SCREEN, view=view).sample(1, (30, 40)))
    assert points.isfinite().all() and shown.any() and not shown.all()


@pytest.mark.parametrize("registered", [True, False])
def test_a_bins_sides_are_a_photo_pixel(registered):
    """By moving half of each side to both sides of the middle, and looking there."""
    view, develop = View(yaw=20.0, pitch=-10.0, roll=8.0), Develop(registered=registered)
    scene = Scene(**SCREEN, view=view, lens=Lens(k1=0.04), develop=develop)
    shot = scene.sample(1, (30, 40))
    bins, inverse = middle_bins(shot), torch.linalg.inv(shot.matrix())
    s = shot.sensor_scale
    for side in (0, 1):
        ends = []
        for half in (-0.5, 0.5):
            photo = (bins.centre + half * bins.sides[..., side]) / s
            image = grids.photo_to_image(photo, inverse, shot.size, shot.distortion)
            ends.append((image if registered else photo)[0, 0, 0])
        expected = [1.0, 0.0] if side == 0 else [0.0, 1.0]
        assert (ends[1] - ends[0]).tolist() == pytest.approx(expected, abs=2e-3)
    area = float(torch.linalg.det(bins.sides[0, 0, 0]).sqrt())
    assert area == pytest.approx(float(shot.bin_scale), rel=1e-6)


@pytest.mark.parametrize("registered", [True, False])
@pytest.mark.parametrize("lens", [Lens(), Lens(k1=0.3), Lens(k1=(-0.1, 0.2))])
@pytest.mark.parametrize("zoom", [1.0, (0.8, 1.3)])
def test_no_bin_is_smaller_than_the_plan_takes_for_the_least(registered, lens, zoom):
    view = View(yaw=(-20.0, 20.0), roll=(-30.0, 30.0), zoom=zoom)
    scene = Scene(**SCREEN, view=view, lens=lens, develop=Develop(registered=registered))
    size = (128, 128)
    least = least_bin_scale(scene_of_size(scene, size), 200.0 / 128)
    bins = scene.sample(200, size, torch.Generator().manual_seed(0)).bin_scale
    assert 0.6 * float(bins.min()) < least <= 1.001 * float(bins.min())
