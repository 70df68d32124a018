"""The pose in numpy is the reference's, to rounding."""

import numpy as np
import pytest
import torch

from moireaug import Lens, Scene, View, capture
from moireaug.engine import reference
from moireaug.engine.lower.full import from_corner
from moireaug.scene import shot_geometry
from moireaug.scene.by_name import with_values
from moireaug.scene.geometry.homography import pose_of

RANGES = {
    "yaw": (-60.0, 60.0),
    "pitch": (-50.0, 50.0),
    "roll": (-180.0, 180.0),
    "zoom": (0.2, 3.0),
    "fov": (5.0, 80.0),
}
LENS = Lens(k1=(-0.05, 0.2), k2=(-0.02, 0.02))


VIEWS = {
    "shifted": View(**RANGES, shift_x=(-0.5, 0.5), shift_y=(-0.5, 0.5)),
    "not fitted": View(**RANGES, fit=False),
    "released": View(pose="released", roll=(-45.0, 45.0)),
}


@pytest.mark.parametrize("size", [(1, 1), (40, 40), (33, 200)])
@pytest.mark.parametrize("view", VIEWS.values(), ids=VIEWS)
def test_homographies_agree(view, size):
    shot = Scene(view=view, lens=LENS).sample(200, size, torch.Generator().manual_seed(0))
    h, w = size
    to_centre, back = np.eye(3), np.eye(3)
    to_centre[:2, 2], back[:2, 2] = (-w / 2, -h / 2), (w / 2, h / 2)
    there = to_centre @ shot.matrix().numpy() @ back
    found = shot.host_geometry(shot.host_numbers()).homography
    assert abs(found - there).max() < 1e-10 * max(size)
    to_photo = np.array([[1, 0, -w / 2], [0, 1, -h / 2], [0, 0, 1]])
    # image to photo and back
    both = from_corner(np.linalg.inv(found), w / 2, h / 2) @ there @ to_photo
    both /= both[:, 2:, 2:]
    assert abs(both - np.eye(3)).max() < 1e-8 * max(size)


@pytest.mark.parametrize("name", ["phone_at_dimmed_phone", "paper"])
def test_the_reference_computes_the_pose_of_a_photo_once_and_of_each_anew(name, monkeypatch):
    scene, poses = Scene.preset(name), []
    monkeypatch.setattr(shot_geometry, "pose_of", lambda *a: poses.append(1) or pose_of(*a))
    shot = scene.sample(1, (8, 9), torch.Generator().manual_seed(0))
    roll = shot.view.roll.clone().requires_grad_()
    shot = with_values(shot, {"view.roll": roll})
    images = torch.rand(1, 3, 8, 9)
    slopes = []
    with reference():
        for _ in range(2):  # no photo takes what belongs to another's graph
            poses.clear()
            photo = capture(images, shot)
            assert len(poses) <= 2  # of exposing and of developing
            slopes += torch.autograd.grad(photo.square().sum(), roll)
    assert torch.equal(*slopes) and slopes[0].isfinite().all()
