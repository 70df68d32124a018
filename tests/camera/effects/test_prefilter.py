"""The prefilter: a picture blurred by a given variance, and by as much as the exposure cannot
see."""

import dataclasses

import pytest
import torch

from moireaug import Lens, Panel, Scene, Sensor, View, capture
from moireaug.camera.effects.prefilter import (
    blur_by_neighbours,
    blur_by_pyramid,
    half_size,
    is_blurred,
    levels_of,
)
from moireaug.engine import reference
from moireaug.scene.geometry import grids
from moireaug.scene.presets import PRESETS


def variance_of(blur):
    """Return a blur's variance along x and y, in squared pixels, for a point of light, as the mean
    over its places."""
    n, places = 64, range(24, 40)
    image = torch.zeros(len(places), 3, n, n, dtype=torch.float64)
    for row, at in zip(image, places, strict=True):
        row[:, at, at] = 1
    off = (torch.arange(n) - torch.tensor(places)[:, None, None]).double().square()
    seen = blur(image)
    assert torch.allclose(seen.sum((2, 3)), torch.ones(()).double())
    return [(seen.sum(axis) * off).sum(2).mean().item() for axis in (2, 3)]


@pytest.mark.parametrize("variance", [0.0, 0.3, 1.0, 5.0, 10.0])
def test_a_prefilter_blurs_by_its_variance(variance):
    wanted = torch.full((16, 1, 1, 1), variance, dtype=torch.float64)
    found = variance_of(lambda image: blur_by_pyramid(image, wanted, 4))
    assert found == pytest.approx([variance] * 2, abs=1e-9)


def test_a_prefilter_blurs_each_place_by_its_own_variance():
    image = torch.rand(1, 3, 24, 32, dtype=torch.float64)
    variance = torch.zeros(1, 1, 24, 32, dtype=torch.float64)
    variance[..., 16:] = 4.0
    half = blur_by_pyramid(image, variance, 3)
    assert torch.equal(half[..., :16], image[..., :16])
    whole = blur_by_pyramid(image, torch.full_like(variance[..., :1, :1], 4.0), 3)
    assert torch.equal(half[..., 16:], whole[..., 16:])


@pytest.mark.parametrize("v", [0.0, 0.2, 0.5])
def test_a_spread_blurs_by_its_variance(v):
    wanted = torch.full((16,), v, dtype=torch.float64)
    found = variance_of(lambda image: blur_by_neighbours(image, wanted))
    assert found == pytest.approx([v, v], abs=1e-12)


@pytest.mark.parametrize("v", [0.2, 0.4, 0.5])
def test_a_spread_inverts_no_pattern(v):
    point = torch.zeros(1, 3, 16, 16, dtype=torch.float64)
    wanted = torch.full((1,), v, dtype=torch.float64)
    point[..., 8, 8] = 1
    transfer = torch.fft.fft2(torch.roll(blur_by_neighbours(point, wanted), (-8, -8), (2, 3)))
    assert transfer.imag.abs().max() < 1e-12
    assert transfer.real.min() > -1e-12
    assert transfer.real.max() < 1 + 1e-12


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (2, 3)])
def test_what_blurs_keeps_a_flat_picture_of_any_size(size):
    flat = torch.full((1, 3, *size), 0.7, dtype=torch.float64)
    v = torch.full((1,), 0.4, dtype=torch.float64)
    assert torch.allclose(blur_by_neighbours(flat, v), flat, atol=1e-12)
    pyramid = blur_by_pyramid(flat, 9 * v[:, None, None, None], 4)
    assert torch.allclose(pyramid, flat, atol=1e-12)


def test_windows_of_an_odd_picture_are_all_as_large():
    """A window over fewer pixels would alias: squares of one pixel are grey at every halving."""
    lines = torch.arange(13)
    board = ((lines[:, None] + lines) % 2).double()[None, None]
    small = half_size(board)
    assert small.shape == (1, 1, 7, 7) and (small[..., :-1, :-1] == 0.5).all()
    once_more = half_size(small)
    assert once_more.shape == (1, 1, 4, 4) and (once_more[..., :-1, :-1] == 0.5).all()


def test_a_pyramid_is_as_high_as_its_variance():
    halvings = {0.6: 1, 1.0: 1, 1.1: 2, 4.0: 2, 16.0: 3, 1e12: 10}
    assert {variance: levels_of(variance) for variance in halvings} == halvings


def lost_variance(scene, size):
    """Return the blur that each pixel of a picture needs, in squared image pixels."""
    places = grids.pixel_centres(size, torch.device("cpu"))
    return scene.plan().method.lost_variance(places, scene.sample(1, size))


def test_what_taps_do_not_hold_is_blurred_first():
    """An aperture and a spread of twelve pixels: seven see part of their variance, and the picture
    has the rest."""
    scene = Scene(
        panel=Panel(layout="even"), view=View(zoom=0.1, fit=False), lens=Lens(blur=0.1),
        sensor=Sensor(cfa="none", exposure="spectral"),
    )  # fmt: skip
    lost = lost_variance(scene, (9, 9))
    whole = 100 * (1 / 12 + 0.1**2)
    assert scene.plan().method.taps == 7
    assert ((lost > 0.3 * whole) & (lost < whole)).all()
    near = dataclasses.replace(scene, view=View())
    assert "prefilter" not in near.plan()
    assert (lost_variance(near, (9, 9)) == 0).all()


@pytest.mark.parametrize("layout", ["rgb_stripe", "chevron", "pentile_diamond"])
def test_the_plan_names_the_blur_that_a_shot_gets(layout):
    """From the front, every place and every subpixel, slanted ones included, needs the same."""
    scene = Scene(panel=Panel(layout=layout), view=View(zoom=0.1, fit=False), lens=Lens(blur=0.1))
    variance = lost_variance(scene, (8, 8))
    assert variance.flatten().tolist() == pytest.approx([scene.plan().prefilter_variance] * 64)


@pytest.mark.parametrize("size", [48, 256, 600])
def test_no_preset_calls_for_it(size):
    assert not {name for name in PRESETS if "prefilter" in Scene.preset(name).plan((size, size))}


TURNED = Scene(
    panel=Panel(width=(60.0, 200.0)),
    view=View(yaw=(0.0, 75.0), fov=60.0),
    lens=Lens(blur=0.4, k1=(0.0, 0.1)),
    sensor=Sensor(pitch=(0.1, 0.6)),
)


@pytest.mark.parametrize("size", [(40, 48), (48, 7)])
def test_corners_and_sides_tell_whether_a_picture_is_blurred(size):
    shot = TURNED.sample(64, size, torch.Generator().manual_seed(0))
    every = shot.plan.method.lost_variance(grids.pixel_centres(size, "cpu"), shot)
    blurred = 2 * every.amax((1, 2)) > TURNED.tolerance
    assert torch.equal(is_blurred(shot), blurred) and 8 < blurred.sum() < 56


def test_a_picture_is_blurred_or_not_whatever_is_photographed_with_it():
    shot = TURNED.sample(6, (40, 48), torch.Generator().manual_seed(0))
    assert 0 < is_blurred(shot).sum() < 6
    images = torch.rand(6, 3, 40, 48, generator=torch.Generator().manual_seed(1))
    photos = capture(images, shot)
    for i in range(6):
        assert torch.equal(photos[i : i + 1], capture(images[i : i + 1], shot[i : i + 1]))
    with reference():
        assert (photos - capture(images, shot)).abs().max() < 2 / 255
