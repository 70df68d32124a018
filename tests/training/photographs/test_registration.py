"""Registration against simulated photos, whose pose the shot knows."""

import numpy as np
import pytest
import torch

from moireaug import Develop, Lens, Panel, Scene, Sensor, View, capture
from training.photographs import registration
from training.photographs.registration import _visible, _warp, find_pose, register

SIZE = (288, 384)


@pytest.fixture(scope="module")
def picture():
    """A picture that can be found: overlapping discs of many sizes, as (3, H, W) uint8."""
    draw = np.random.default_rng(0)
    height, width = SIZE
    y, x = np.mgrid[0.5:height, 0.5:width]
    found = np.full((3, height, width), 128.0)
    for _ in range(250):
        inside = np.hypot(x - draw.uniform(0, width), y - draw.uniform(0, height))
        found[:, inside < draw.uniform(3, 30)] = draw.uniform(20, 235, (3, 1))
    return torch.from_numpy(found).to(torch.uint8)


def photographed(picture, **view):
    sensor = Sensor(scale=2.0, gain=2.8, read_noise=0.005)
    develop = Develop(registered=False, linear_light=True)
    panel, lens = Panel(scale=1.1), Lens(blur=0.5)
    scene = Scene(panel=panel, view=View(**view), lens=lens, sensor=sensor, develop=develop)
    shot = scene.sample(1, SIZE, torch.Generator().manual_seed(0))
    photo = capture(picture[None].float() / 255, shot)[0]
    return (255 * photo).round().to(torch.uint8), shot.matrix()[0].numpy()


def largest_error(found, true):
    """Return how far the corners of the picture are mapped from where they belong, in pixels."""
    height, width = SIZE
    corners = np.array([[0, 0, 1], [width, 0, 1], [width, height, 1], [0, height, 1]], float)
    ours, theirs = corners @ found.T, corners @ true.T
    return np.abs(ours[:, :2] / ours[:, 2:] - theirs[:, :2] / theirs[:, 2:]).max()


VIEWS = [{}, {"yaw": -20.0, "roll": -12.0, "fov": 50.0}, {"roll": 30.0, "zoom": 0.8}]
VIEWS += [{"yaw": 18.0, "pitch": -9.0, "roll": 5.0}]


@pytest.mark.parametrize("view", VIEWS)
def test_the_pose_of_a_photo_is_found(picture, view):
    photo, true = photographed(picture, **view)
    assert largest_error(find_pose(photo, picture), true) < 0.35


def test_a_photo_comes_to_the_frame_of_its_picture(picture):
    photo, _ = photographed(picture, yaw=18.0, pitch=-9.0, roll=5.0)
    aligned, original = register(photo, picture)
    assert aligned.shape == original.shape
    assert original.shape[1] > 0.9 * SIZE[0]
    pairs = torch.stack([aligned.float().mean(0).flatten(), original.float().mean(0).flatten()])
    assert torch.corrcoef(pairs)[0, 1] > 0.9
    # an unregistered photo is nothing like it
    plain = torch.stack([photo.float().mean(0).flatten(), picture.float().mean(0).flatten()])
    assert torch.corrcoef(plain)[0, 1] < 0.7


def test_a_small_picture_is_found_within_a_fifth_pixel(picture):
    small = picture[:, ::2, ::2]
    large = torch.nn.functional.interpolate(small[None].float(), scale_factor=8, mode="bilinear")
    photo = torch.nn.functional.pad(large[0], (40, 40, 40, 40), value=30).to(torch.uint8)
    found = np.linalg.inv(find_pose(photo, small))
    true = np.array([[1 / 8, 0, -5], [0, 1 / 8, -5], [0, 0, 1]])
    to_picture = found @ np.linalg.inv(true)  # the identity where the pose is right
    assert largest_error(to_picture / to_picture[2, 2], np.eye(3)) < 0.2
    # negative control: a pixel off
    assert largest_error(np.array([[1, 0, 1], [0, 1, 0], [0, 0, 1]]), np.eye(3)) == 1


def test_no_strip_that_the_photo_does_not_show_is_left():
    """The photo is all white; where it does not reach, the picture's frame stays black."""
    size = (447, 600)
    for dx, dy in ((3.0, 1.0), (-9.0, 3.0), (0.0, 30.0)):
        matrix = np.array([[1, 0, dx], [0, 1, dy], [0, 0, 1]])
        warped = _warp(np.full((*size, 3), 255, np.uint8), matrix, size)
        rows, columns = _visible(matrix, size, size)
        assert warped.min() == 0 and warped[rows, columns].min() == 255
        assert warped[rows, columns].size > 0.6 * warped.size


def test_what_the_photo_does_not_show_is_cut_off_both(picture):
    photo, _ = photographed(picture, yaw=10.0, zoom=1.4)
    aligned, original = register(photo, picture)
    assert aligned.shape == original.shape
    assert 0.3 * SIZE[0] < original.shape[1] < 0.8 * SIZE[0]
    # no part of it is the black that lies off the photo
    assert aligned.float().mean(0).flatten().quantile(0.02) > 10


def test_a_picture_that_is_hardly_in_view_is_refused(picture, monkeypatch):
    for shift in (380.0, 5000.0):
        pose = np.array([[1, 0, shift], [0, 1, 0], [0, 0, 1]])
        monkeypatch.setattr(registration, "find_pose", lambda *_, pose=pose: pose)
        with pytest.raises(ValueError, match="it must show most of it"):
            registration.register(picture, picture)


def test_a_photo_of_something_else_is_refused(picture):
    other = picture.flip(1).flip(2)[[2, 0, 1]].float()
    noise = 60 * torch.randn(3, *SIZE, generator=torch.Generator().manual_seed(0))
    other = (other.roll(97, 2).flip(2) + noise).clamp(0, 255).to(torch.uint8)
    with pytest.raises(ValueError, match=r"the picture was not found in IMG_1\.jpg: \d+ features"):
        register(other, picture, "IMG_1.jpg")


def test_a_mirrored_photo_and_a_flat_one_are_refused(picture):
    photo, _ = photographed(picture, yaw=5.0)
    for refused in (photo.flip(2), torch.full_like(photo, 90)):
        with pytest.raises(ValueError, match="not found"):
            find_pose(refused, picture)
