"""The picture as a panel shows it, in the reference and in the engine, against a matrix of
weights."""

import math

import numpy as np
import pytest
import torch

from moireaug import Develop, Lens, Panel, Scene, Sensor, View, expose
from moireaug.camera import pipeline
from moireaug.camera.exposure.bin_content import content_of
from moireaug.camera.exposure.screen import DisplayedPicture, on_panel
from moireaug.engine.cpu import expose_kernels, panel
from moireaug.engine.lower.exposure import lower_exposure
from moireaug.engine.lower.exposure_records import Camera
from moireaug.scene.by_name import with_values
from tests.engine.readings import assert_equal, readings

ALPHAS = (1e-3, 0.01, 0.3, 0.73, 1.0, 1.7, 3.0)
SIZES = [(20, 27), (1, 1), (1, 9), (8, 1)]
MARGIN = (11, 10)
MIXED = Panel(scale=(0.2, 2.0))
SHOT, ONES = Scene(panel=MIXED).sample(2, (6, 7)), torch.ones(2, dtype=torch.float64)


def triangle(size, count, alpha, ahead):
    """How much each of `count` panel pixels, the first `ahead` before the picture, shows of each
    image pixel: a triangle around its centre, one panel or image pixel to each side."""
    half, weights = max(1.0, 1 / alpha), np.zeros((count, size))
    for i in range(count):
        centre = (i - ahead + 0.5) / alpha
        for pixel in range(math.floor(centre - half) - 1, math.ceil(centre + half) + 1):
            nearest = min(max(pixel, 0), size - 1)
            weights[i, nearest] += max(0.0, 1 - abs(pixel + 0.5 - centre) / half)
    return torch.from_numpy(weights / weights.sum(1, keepdims=True))


def by_matrix(picture, alpha, size, margin):
    """What a panel of `size` pixels, a margin included, shows of a picture (3, H, W)."""
    (height, width), (h, w) = picture.shape[1:], size
    down = triangle(height, h, alpha, margin[0])
    return down @ picture @ triangle(width, w, alpha, margin[1]).T


def panel_size(alpha, size):
    return tuple(math.ceil(alpha * n) + 2 * ahead for n, ahead in zip(size, MARGIN, strict=True))


def shown_by(alpha, picture):
    """What the reference shows of a picture (B, 3, H, W)."""
    size = tuple(picture.shape[2:])
    shot = Scene(panel=Panel(scale=alpha)).sample(len(picture), size)
    return on_panel(DisplayedPicture(picture, shot), panel_size(alpha, size), MARGIN)


@pytest.mark.parametrize("alpha", ALPHAS)
def test_a_panel_pixel_shows_the_mean_under_a_triangle(alpha):
    for size in SIZES:
        picture = torch.rand(1, 3, *size, dtype=torch.float64)
        expected = by_matrix(picture[0], alpha, panel_size(alpha, size), MARGIN)
        assert torch.allclose(shown_by(alpha, picture)[0], expected, atol=1e-12), size


def engine_shows(scene, picture):
    """What the engine's panel shows of a picture (1, 3, H, W): red, whose cells are stored a first
    pixel after another, in order; and the margin."""
    exposure, _ = lower_exposure(scene.sample(1, tuple(picture.shape[2:])), decoded=False)
    shown = np.empty(expose_kernels.shown_length(exposure, False), np.float32)
    light = np.empty(picture.shape[1:], np.float32)
    expose_kernels.show_kernel(shown, light, picture.numpy(), exposure, False, 0)
    cell, camera = exposure.cell, Camera(*exposure.cameras[0])
    h, w = panel.shape.py_func(exposure.size, camera, cell)
    period = int(cell.period[cell.subpixel_kind[cell.channel.tolist().index(0)], 0])
    red = torch.from_numpy(shown).reshape(3, h, period, w // period)[0]
    return red.mT.reshape(h, w), tuple(panel.margin.py_func(cell, axis) for axis in (1, 0))


@pytest.mark.parametrize("layout", ["rgb_stripe", "pentile"])
@pytest.mark.parametrize("alpha", ALPHAS)
def test_the_engines_panel_shows_the_same(alpha, layout):
    for size in SIZES:
        picture = torch.rand(1, 3, *size)
        seen, margin = engine_shows(Scene(panel=Panel(scale=alpha, layout=layout)), picture)
        expected = by_matrix(picture[0].double(), alpha, tuple(seen.shape), margin)[0]
        assert (seen - expected).abs().max() < 1e-5, size


def test_the_engines_panel_is_black_past_the_picture():
    for alpha in (0.3, 0.73, 1.7):
        scene = Scene(panel=Panel(scale=alpha), develop=Develop(registered=False))
        seen, margin = engine_shows(scene, torch.full((1, 3, 12, 15), 0.7))
        on = []
        for count, ahead, size in zip(seen.shape, margin, (12, 15), strict=True):
            centre = (torch.arange(count).double() - ahead + 0.5) / alpha
            on.append((centre >= 0) & (centre < size))
        assert torch.allclose(seen, 0.7 * (on[0][:, None] & on[1]), atol=1e-6)


@pytest.mark.parametrize("exposure", ["spectral", "box", "mean", "point", "supersample:2"])
def test_a_coarse_panel_shows_no_detail_of_its_own(exposure):
    """Half as many panel pixels as image pixels: stripes of one pixel are grey, whatever the
    method."""
    stripes = (torch.arange(40) % 2).double().expand(1, 3, 40, 40)
    sensor = Sensor(cfa="none", exposure=exposure)
    scene = Scene(panel=Panel(layout="even", scale=0.5), sensor=sensor)
    raw = expose(stripes, scene.sample(1, (40, 40)))
    assert (raw - 0.5)[..., 4:-4, 4:-4].abs().max() < 1e-6


@pytest.mark.parametrize("alpha", [0.37, 0.8, 1.3])
def test_what_a_panel_shows_has_its_slope(alpha):
    """In the picture and in the panel's width."""
    picture = torch.rand(2, 3, 6, 7, dtype=torch.float64, requires_grad=True)
    width = torch.full((2,), 7 * alpha, dtype=torch.float64, requires_grad=True)
    shot = Scene(panel=Panel(width=7 * alpha)).sample(2, (6, 7))

    def show(picture, width):
        drawn = with_values(shot, {"panel.width": width})
        return on_panel(DisplayedPicture(picture, drawn), panel_size(alpha, (6, 7)), MARGIN)

    assert torch.autograd.gradcheck(show, (picture, width), fast_mode=True)
    assert torch.autograd.gradgradcheck(show, (picture, width), fast_mode=True)


@pytest.mark.filterwarnings("ignore:.torch.jit.script:FutureWarning")  # PyTorch's own call
@pytest.mark.parametrize("alpha", [0.37, 0.8])
def test_a_slope_forward_is_the_slope_backward(alpha):
    picture = torch.rand(2, 3, 6, 7, dtype=torch.float64)
    given, along = (picture, torch.full((2,), alpha).double()), (torch.rand_like(picture), ONES)

    def show(picture, alpha):
        displayed = DisplayedPicture(picture, SHOT, content_of(SHOT)._replace(scale=alpha))
        return on_panel(displayed, panel_size(1, (6, 7)), MARGIN).square().sum()

    _, forward = torch.func.jvp(show, given, along)
    backward = torch.func.grad(show, argnums=(0, 1))(*given)
    total = sum((slope * step).sum() for slope, step in zip(backward, along, strict=True))
    assert forward.item() == pytest.approx(total.item(), rel=1e-9)


@pytest.mark.parametrize("exposure", ["auto", "mean", "point", "supersample:2"])
def test_images_are_read_alike_alone_and_in_a_transform(exposure):
    """Of panels coarser and finer than the picture."""
    sensor = Sensor(scale=2.0, exposure=exposure)
    scene = Scene(panel=MIXED, view=View(roll=4.0), lens=Lens(blur=0.3), sensor=sensor)
    shot = scene.sample(4, (12, 15), torch.Generator().manual_seed(1))
    assert shot.panel_scale.min() < 1 < shot.panel_scale.max()
    images = torch.rand(4, 3, 12, 15, dtype=torch.float64)
    together = pipeline.expose(images, shot)
    alone = torch.cat([pipeline.expose(images[i : i + 1], shot[i]) for i in range(4)])
    assert torch.allclose(together, alone, atol=1e-12)
    mapped = torch.func.vmap(lambda x: pipeline.expose(x, shot))(torch.stack([images, images]))
    assert torch.allclose(mapped, together.expand(2, -1, -1, -1, -1), atol=1e-12)


@pytest.mark.parametrize("registered", [True, False])
@pytest.mark.parametrize(("layout", "exposure"), [("rgb_stripe", "mean"), ("pentile", "spectral")])
def test_the_engine_reads_mixed_panels_as_the_reference_does(layout, exposure, registered):
    parts = {"lens": Lens(blur=0.3), "sensor": Sensor(scale=2.0, exposure=exposure)}
    parts |= {"panel": Panel(scale=(0.1, 1.5), layout=layout)}
    view, develop = View(yaw=(-20.0, 20.0), roll=(-10.0, 10.0)), Develop(registered=registered)
    scene = Scene(view=view, develop=develop, **parts)
    assert_equal(*readings(scene, (40, 52), n=6))
