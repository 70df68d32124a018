"""The resize of codes: means of windows, triangles, and points."""

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from moireaug import Develop, Panel, Scene, Sensor, develop
from moireaug.camera import pipeline
from moireaug.camera.effects.base import Effect, called
from moireaug.camera.effects.resize import area_means, area_weights, resize, window_centres
from moireaug.scene.geometry.lattice import sampled_pixels


def resized(photo, size, scale, how):
    rows, cols = (sampled_pixels(n, scale, how, 0) for n in size)
    assert photo.shape[-2:] == (len(rows.index), len(cols.index))
    return resize(photo, rows, cols, how)


@pytest.mark.parametrize(("step", "middle"), [(1, [0]), (2, [0, 1]), (4, [1, 2]), (5, [2])])
def test_the_centre_of_a_window(step, middle):
    photo = torch.rand(1, 3, 2 * step, 3 * step, dtype=torch.float64)
    windows = photo.reshape(1, 3, 2, step, 3, step)[:, :, :, middle][..., middle]
    assert torch.allclose(window_centres(photo, step), windows.mean((3, 5)))


@pytest.mark.parametrize("scale", [1.0, 2.0, 3.0])
def test_area_is_the_mean_of_windows(scale):
    s = int(scale)
    photo = torch.rand(2, 3, 4 * s, 5 * s, dtype=torch.float64)
    assert torch.allclose(resized(photo, (4, 5), scale, "area"), F.avg_pool2d(photo, s))


@pytest.mark.parametrize("scale", [9.0, 8.0, 3.0])
def test_points_are_those_of_a_resize_without_antialias(scale):
    """Of the few pixels that a point reads, what a bilinear resize of the whole sensor gives: the
    paper's resize."""
    s = int(scale)
    whole = torch.rand(1, 3, 3 * s, 4 * s, dtype=torch.float64)
    rows, cols = (torch.tensor(sampled_pixels(n, scale, "point", 0).index) for n in (3, 4))
    found = resized(whole[..., rows, :][..., cols], (3, 4), scale, "point")
    wanted = F.interpolate(whole, size=(3, 4), mode="bilinear", align_corners=False)
    assert torch.allclose(found, wanted)


@pytest.mark.parametrize("how", ["area", "antialias", "point"])
@pytest.mark.parametrize("size", [(5, 1), (4, 3), (1, 1)])
def test_a_turned_photo_is_resized_as_the_photo(how, size):
    """torch's antialiased resize to a single column is that of another photo."""
    rows, cols = (len(sampled_pixels(n, 2.0, how, 0).index) for n in size)
    photo = torch.rand(2, 3, rows, cols, dtype=torch.float64)
    turned = resized(photo.mT.contiguous(), size[::-1], 2.0, how)
    assert torch.allclose(resized(photo, size, 2.0, how).mT, turned)


@pytest.mark.parametrize("how", ["area", "antialias", "point"])
def test_a_flat_photo_stays_flat(how):
    for scale in (0.5, 1.0, 1.5, 2.0, 3.0):
        rows, cols = (len(sampled_pixels(n, scale, how, 0).index) for n in (4, 7))
        out = resized(torch.full((1, 3, rows, cols), 0.3, dtype=torch.float64), (4, 7), scale, how)
        assert out.shape == (1, 3, 4, 7) and torch.allclose(out, torch.full_like(out, 0.3))


@pytest.mark.parametrize("how", ["area", "antialias", "point"])
@pytest.mark.parametrize("scale", [1.5, 2.5, 3.0])
def test_no_photo_exceeds_white_and_white_has_a_gradient(scale, how):
    sensor = Sensor(scale=scale)
    scene = Scene(panel=Panel(layout="even"), sensor=sensor, develop=Develop(resize=how))
    shot = scene.sample(1, (13, 10))
    for step in (develop, pipeline.develop):
        raw = torch.ones(shot.raw_shape(), requires_grad=True)
        photo = step(raw, shot)
        assert photo.max() == 1 and photo.min() > 1 - 1e-6
        photo.sum().backward()
        assert raw.grad.sum().item() == pytest.approx(photo.numel(), rel=1e-4)


@pytest.mark.parametrize(("n", "m"), [(7, 3), (10, 4), (101, 37), (5, 8), (241, 56)])
def test_areas_that_do_not_divide_are_shared_exactly(n, m):
    """Each pixel's light goes where its area lies: the mean is kept, and a ramp stays a ramp."""
    start, shares = (np.array(values) for values in area_weights(n, m))
    assert np.allclose(shares.sum(1), 1) and (shares >= 0).all()
    given = np.zeros(n + shares.shape[1])
    for first, row in zip(start, shares, strict=True):
        given[first : first + len(row)] += row
    assert np.allclose(given[:n], m / n) and np.allclose(given[n:], 0)
    ramp = torch.arange(n, dtype=torch.float64)[None, None, :, None] + 0.5
    middles = (torch.arange(m, dtype=torch.float64) + 0.5) * n / m
    assert (area_means(ramp, m)[0, 0, :, 0] - middles).abs().max() < (0.5 if m > n else 0.13)


@pytest.mark.parametrize(("every", "side"), [(True, 144), (False, 48)])
def test_an_effect_before_the_resize_may_ask_for_every_pixel(every, side, monkeypatch):
    sizes = []

    class Own(Effect):
        name = "own"
        needs_every_pixel = every

        def verdict(self, scene):
            return called("always")

        def __call__(self, photo, shot):
            sizes.append(tuple(photo.shape[-2:]))
            return photo

    place = [effect.name for effect in pipeline.DEVELOP].index("chroma_blur")
    effects = (*pipeline.DEVELOP[:place], Own(), *pipeline.DEVELOP[place:])
    monkeypatch.setattr(pipeline, "DEVELOP", effects)
    scene = Scene(sensor=Sensor(scale=9.0), develop=Develop(resize="point"))
    scene.capture(torch.rand(1, 3, 16, 16))
    assert sizes == [(side, side)]
