"""Noise and clipping of kernels equal the reference's functions, and the picture's light its
effects."""

import pytest
import torch

pytest.importorskip("triton")
import triton
import triton.language as tl

from moireaug import Develop, Lens, Panel, Scene, Sensor, View
from moireaug.camera import pipeline
from moireaug.camera.effects import random_numbers
from moireaug.camera.exposure.screen import EDGE_PIXELS, shrink
from moireaug.common.tensor_physics import clipping
from moireaug.engine.gpu import panel, sensor
from moireaug.engine.gpu import sensor as gpu_random_numbers
from moireaug.engine.gpu.arrays import NOTHING, upload
from moireaug.engine.lower.exposure import lower_exposure
from moireaug.engine.stages import DECODING

CPU = torch.device("cpu")
N = 64


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
    expected = clipping.expected_clip(light, lost, light.square() * pattern)
    (grad,) = torch.autograd.grad(expected.sum(), light)
    assert (out - expected).abs().max() < 1e-6
    assert (slope - grad).abs().max() < 1e-6


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
