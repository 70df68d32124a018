"""What kernels compute of one pixel equals the reference's functions, and the picture's light its
effects."""

from typing import Any, NamedTuple

import numpy as np
import pytest
import torch

pytest.importorskip("triton")
import triton
import triton.language as tl

from moireaug import Develop, Lens, Panel, Scene, Sensor, View, pipeline
from moireaug.effects import random_numbers
from moireaug.effects.binned_statistics import expected_clip
from moireaug.engine.dispatch import DECODING
from moireaug.engine.gpu import optics, panel, sensor, tile, view
from moireaug.engine.gpu import random_numbers as gpu_random_numbers
from moireaug.engine.gpu.arrays import NOTHING, upload
from moireaug.engine.lower.exposure import lower_exposure
from moireaug.exposure.displayed import EDGE_PIXELS, shrink
from moireaug.exposure.optics import optics_of
from moireaug.geometry import grids

CPU = torch.device("cpu")
N = 64


@triton.jit
def _fill_blocks(out, count, BLOCK: tl.constexpr):
    group, i = tile.block(count, BLOCK)
    tl.store(out + group * count + i, (group * 100 + i).to(tl.int32), mask=i < count)


@triton.jit
def _normal(out, keys, quantiles, N: tl.constexpr):
    i = tl.arange(0, N)
    tl.store(out + i, gpu_random_numbers.normal(i, keys, quantiles))


@triton.jit
def _clipped_mean(out, slope, light, dark, photons, pattern, N: tl.constexpr):
    i = tl.arange(0, N)
    mean, by_light = sensor.clipped_mean(tl.load(light + i), dark, photons, pattern)
    tl.store(out + i, mean)
    tl.store(slope + i, by_light)


@triton.jit
def _view(out, u, v, camera, forward, N: tl.constexpr):
    i = tl.arange(0, N)
    u, v = tl.load(u + i), tl.load(v + i)
    x, y = view.to_image(u, v, camera)
    back_u, back_v = view.to_photo(x, y, forward, view.lens_of(camera), True)
    xu, xv, yu, yv = view.jacobian(u, v, camera)
    values = (x, y, back_u, back_v, xu, xv, yu, yv)
    for row in tl.static_range(8):
        tl.store(out + row * N + i, values[row])


@triton.jit
def _transfer(out, fu, fv, camera, N: tl.constexpr):
    i = tl.arange(0, N)
    tl.store(out + i, optics.transfer(tl.load(fu + i), tl.load(fv + i), camera))


def test_blocks_cover_each_group():
    out = torch.full((3, 5), -1, dtype=torch.int32)
    _fill_blocks[(6,)](out, 5, BLOCK=4)
    assert torch.equal(out, 100 * torch.arange(3)[:, None] + torch.arange(5))


def test_noise_is_the_references_bit_for_bit():
    seeds, out = torch.tensor([-(2**62) + 12345]), torch.empty(1024)
    keys = torch.cat(random_numbers.keys(seeds))
    _normal[(1,)](out, keys, gpu_random_numbers.quantiles(CPU), N=1024)
    assert torch.equal(out, random_numbers.normal((1024,), seeds)[0])


@pytest.mark.parametrize("variances", [(0.0, 0.0, 0.0), (1e-4, 1e-3, 0.3), (1e-3, 1e-3, 9.0)])
def test_the_mean_of_clipped_pixels_and_its_slope(variances):
    dark, photons, pattern = variances
    light = torch.linspace(-0.05, 3, N)
    out, slope = torch.empty(2, N)
    _clipped_mean[(1,)](out, slope, light, *variances, N=N)
    light = light.double().requires_grad_()
    lost = dark + photons * light.clamp(min=1e-4)
    expected = expected_clip(light, lost, light.square() * pattern)
    (grad,) = torch.autograd.grad(expected.sum(), light)
    assert (out - expected).abs().max() < 1e-6
    assert (slope - grad).abs().max() < 1e-6


BENT = Scene(
    view=View(yaw=20.0, pitch=-12.0, roll=8.0, fov=40.0),
    lens=Lens(k1=-0.05, k2=0.03, blur=0.3, olpf=0.6, motion_x=0.4, motion_y=-0.2),
    sensor=Sensor(scale=2.0, fill=0.8),
)


class Numbers(NamedTuple):
    cameras: Any
    forward: Any


def camera_of(scene, size):
    """A shot, its camera's record, and the inverse of its homography."""
    shot = scene.sample(1, size)
    exposure = lower_exposure(shot, decoded=False)[0]
    forward = np.linalg.inv(exposure.cameras[:, :9].reshape(3, 3))
    return shot, upload(Numbers(exposure.cameras[0], forward), CPU)


def test_where_pixels_look():
    size = (30, 40)
    shot, numbers = camera_of(BENT, size)
    g = torch.Generator().manual_seed(1)
    points = torch.rand(1, 1, N, 2, generator=g, dtype=torch.float64)
    points = points * torch.tensor([40.0, 30.0], dtype=torch.float64)
    u, v = points[0, 0, :, 0] - 20, points[0, 0, :, 1] - 15
    out = torch.empty(8, N, dtype=torch.float64)
    _view[(1,)](out, u, v, numbers.cameras, numbers.forward, N=N)
    inverse = torch.linalg.inv(shot.matrix())
    images = grids.photo_to_image(points, inverse, size, shot.distortion)[0, 0]
    assert (out[:2].T - images).abs().max() < 1e-9
    assert (out[2] - u).abs().max() < 1e-9
    assert (out[3] - v).abs().max() < 1e-9
    step = grids.jacobian(points, inverse, size, shot.distortion)[0, 0] / 2
    assert (out[4:].T.reshape(N, 2, 2) - step).abs().max() < 1e-6


def test_the_transfer_of_the_optics():
    shot, numbers = camera_of(BENT, (8, 8))
    f = torch.randn(2, N, generator=torch.Generator().manual_seed(2))
    out = torch.empty(N)
    _transfer[(1,)](out, *f, numbers.cameras, N=N)
    assert (out - optics_of(shot).transfer(*f.double())).abs().max() < 1e-6


SHOWN = {
    "codes": Scene(panel=Panel(black=0.1), develop=Develop(linear_light=True)),
    "light": Scene(panel=Panel(black=0.1)),
    "prefiltered": Scene(
        panel=Panel(scale=1.3, black=0.05), view=View(zoom=0.2), lens=Lens(blur=0.5),
        sensor=Sensor(scale=2.0), develop=Develop(linear_light=True),
    ),
}  # fmt: skip


def lowered(shot):
    """A shot's exposure, and the same uploaded."""
    exposure = lower_exposure(shot, decoded=False)[0]
    return exposure, upload(exposure._replace(budget=NOTHING), CPU)


@pytest.mark.parametrize("name", SHOWN)
def test_the_pictures_light_and_its_gradient(name):
    shot = SHOWN[name].sample(2, (9, 12))
    assert ("prefilter" in shot.plan) == (name == "prefiltered")
    picture = torch.rand(2, 3, 9, 12, requires_grad=True)
    exposure, uploaded = lowered(shot)
    got = panel.show(picture, exposure, uploaded)
    named = [name for name in shot.plan.exposing if name in DECODING]
    expected = pipeline.apply(named, picture.double(), shot)
    assert got.lead == 0
    assert (got.light - expected).abs().max() < 1e-6
    grad = torch.randn_like(picture)
    (expected,) = torch.autograd.grad(expected, picture, grad.double())
    assert (panel.show_back(grad, picture, exposure, uploaded) - expected).abs().max() < 1e-5


def test_bytes_are_read_as_they_are():
    shot = SHOWN["codes"].sample(1, (9, 12))
    codes = torch.randint(0, 256, (1, 3, 9, 12), dtype=torch.uint8)
    exposure, uploaded = lowered(shot)
    read = [panel.show(picture, exposure, uploaded).light for picture in (codes, codes / 255)]
    assert (read[0] - read[1]).abs().max() < 1e-6


def test_what_a_coarse_panel_shows_and_the_gradient():
    scene = Scene(panel=Panel(scale=(0.3, 0.9)), develop=Develop(linear_light=False))
    shot = scene.sample(2, (9, 12), torch.Generator().manual_seed(1))
    picture = torch.rand(2, 3, 9, 12, requires_grad=True)
    exposure, uploaded = lowered(shot)
    got = panel.show(picture, exposure, uploaded)
    scale = shot.panel_scale
    expected = shrink(picture, scale, float(scale.min()), float(scale.max()))
    assert got.lead == EDGE_PIXELS
    assert (got.light - expected).abs().max() < 1e-5
    grad = torch.randn_like(got.light)
    (expected,) = torch.autograd.grad(expected, picture, grad)
    assert (panel.show_back(grad, picture, exposure, uploaded) - expected).abs().max() < 1e-5
