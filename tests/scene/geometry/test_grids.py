"""Sampling grids: their Jacobian is their derivative, and nothing past the horizon runs away."""

import pytest
import torch

from moireaug import Lens, Scene, View
from moireaug.scene.geometry import grids
from moireaug.scene.geometry.distortion import inverse_radial_factor, radial_factor

SIZE = (30, 40)
SCENES = {
    "frontal": Scene(view=View(zoom=0.9)),
    "oblique": Scene(view=View(yaw=30, pitch=-20, roll=15, shift_x=0.1)),
    "bent": Scene(view=View(yaw=-20), lens=Lens(k1=0.1, k2=0.05)),
    "pincushion": Scene(lens=Lens(k1=-0.15)),
    "released": Scene(view=View(yaw=10, roll=-7, pose="released")),
}


def camera_of(scene):
    """What `grids` takes beside points: an inverse homography, a size and a lens."""
    shot = scene.sample(1, SIZE, torch.Generator().manual_seed(1))
    return torch.linalg.inv(shot.matrix()), SIZE, shot.distortion


@pytest.mark.parametrize("name", SCENES)
def test_the_jacobian_is_the_derivative(name):
    rows, cols = torch.tensor([[2.0, 15.0, 29.0], [1.0, 20.0, 39.0]]).double()
    points, camera, step = grids.grid(rows, cols), camera_of(SCENES[name]), 1e-5
    found = grids.jacobian(points, *camera)
    for axis in (0, 1):
        off = step * torch.eye(2).double()[axis]
        ahead, behind = (grids.photo_to_image(p, *camera) for p in (points + off, points - off))
        slope = (ahead - behind) / (2 * step)
        assert (found[..., axis] - slope).abs().max() < 1e-7 * slope.abs().max()


def test_past_the_horizon_positions_and_jacobians_are_finite_in_float32():
    camera = camera_of(Scene(view=View(yaw=89, pitch=89, fov=89)))
    points = grids.pixel_centres(SIZE, torch.device("cpu"))
    assert grids.photo_to_image(points, *camera).float().isfinite().all()
    assert grids.jacobian(points, *camera).square().sum((-1, -2)).float().isfinite().all()


def test_a_look_up_is_bilinear_up_to_the_border():
    picture = torch.tensor([[0.0, 1.0], [2.0, 3.0]]).double()[None, None]
    x = torch.tensor([[[0.5, 1.0, 1.5, -9.0, 99.0]]]).double()
    across, down = (grids.look_up(picture, *at) for at in ((x, x * 0 + 0.5), (x * 0 + 0.5, x)))
    assert across.flatten().tolist() == pytest.approx([0, 0.5, 1, 0, 1])
    assert down.flatten().tolist() == pytest.approx([0, 1, 2, 0, 2])


@pytest.mark.parametrize(
    ("k1", "k2"), [(0.61, -0.555), (0.9, -0.71), (0.775, -0.65), (-0.98, 0.66), (-0.3, 0.0)]
)
def test_a_lens_that_nearly_folds_is_inverted(k1, k2):
    """Newton's steps from the ideal radius went back and forth between 0 and the corners."""
    Lens(k1=k1, k2=k2)  # which is allowed
    k1, k2 = (torch.tensor([k], dtype=torch.float64) for k in (k1, k2))
    corner = torch.tensor([SIZE[1] / 2, SIZE[0] / 2], dtype=torch.float64)
    points = (torch.linspace(0, 1, 401, dtype=torch.float64)[:, None] * corner)[None]
    ideal = points * radial_factor(points, k1, k2, SIZE)[..., None]
    back = ideal * inverse_radial_factor(ideal, k1, k2, SIZE)[..., None]
    assert (back - points).abs().max() < 1e-9
