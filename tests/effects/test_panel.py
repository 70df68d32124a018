"""The panel: layouts as data, what is derived from them, and the picture blurred by a given variance."""

import json
import math
import pickle

import pytest
import torch

from moireaug import Lens, Panel, Scene, Sensor, Shot, View, capture, expose
from moireaug.effects.panel import LAYOUTS, Layout, Subpixel, as_layout, coefficient, emits, prefilter, spread

OWN = Layout(((0, 0.0, 0.0, 0.5, 1.0), (1, 0.5, 0.0, 1.0, 0.4), (2, 1.25, 0.5, 1.75, 1.0)), (2, 1))
RED_ONLY = Layout(((0, 0.0, 0.0, 0.5, 1.0),))
ALL = {**LAYOUTS, "own": OWN}

BAD = [
    (lambda: Layout(()), "at least one"),
    (lambda: Layout(((0, 0, 0, 1, 1),), (1,)), "two whole numbers of panel pixels in [1, 16]; got (1,)"),
    (lambda: Layout(((0, 0, 0, 1, 1),), (1, 0)), "in [1, 16]; got (1, 0)"),
    (lambda: Layout(((0, 0, 0, 1, 1),), (1.0, 1)), "in [1, 16]; got (1.0, 1)"),
    (lambda: Layout(((0, 0, 0, 1),)), "(channel, x0, y0, x1, y1) numbers; got (0, 0, 0, 1)"),
    (lambda: Layout((("red", 0, 0, 1, 1),)), "numbers; got ('red', 0, 0, 1, 1)"),
    (lambda: Layout(((True, 0, 0, 1, 1),)), "numbers; got (True, 0, 0, 1, 1)"),
    (lambda: Layout(((3, 0, 0, 1, 1),)), "0 (red), 1 (green) or 2 (blue); got 3"),
    (lambda: Layout(((0, 0, 0, 1.5, 1),)), "inside its cell of 1 x 1 panel pixels"),
    (lambda: Layout(((0, 0.5, 0, 0.5, 1),)), "x0 < x1 and y0 < y1"),
    (lambda: Layout(((0, 0, math.nan, 1, 1),)), "x0 < x1 and y0 < y1"),
    (lambda: Layout(((1, 0, 0, 0.6, 1), (1, 0.5, 0.5, 1, 1))), "must not overlap; got (1, 0, 0, 0.6, 1) and"),
    (lambda: Panel(layout="pentil"), "Did you mean 'pentile'?"),
    (lambda: Panel(layout=3), "must be one of 'rgb_stripe'"),
    (lambda: Layout(5), "Layout.subpixels must be a tuple; got 5"),
    (lambda: Layout(((0, 0, 0, 1, 1),), (True, 1)), "in [1, 16]; got (True, 1)"),
    (lambda: Panel(layout={"subpixel": ()}), "Did you mean 'subpixels'?"),
]


@pytest.mark.parametrize(("make", "sentence"), BAD, ids=[b[1][:30] for b in BAD])
def test_wrong_layouts_get_a_sentence(make, sentence):
    with pytest.raises((ValueError, TypeError)) as error:
        make()
    assert sentence in str(error.value)


def test_channels_read_from_an_array_are_as_good():
    floats = Layout(((0.0, 0.0, 0.0, 0.5, 1.0),))
    assert Scene(panel=Panel(layout=floats)).plan() == Scene(panel=Panel(layout=RED_ONLY)).plan()


def test_rectangles_of_different_colours_may_overlap():
    assert len(Layout(((0, 0, 0, 0.6, 1), (1, 0.5, 0, 1, 1))).subpixels) == 2


def test_subpixels_know_their_place():
    (red,), (green,), (blue,) = (OWN.of(c) for c in range(3))
    assert (red, green) == (Subpixel(0, 0.0, 0.0, 0.5, 1.0), Subpixel(1, 0.5, 0.0, 1.0, 0.4))
    assert (blue.width, blue.centre, blue.pixel) == ((0.5, 0.5), (1.5, 0.75), (1.5, 0.5))
    assert [s.pixel for s in LAYOUTS["pentile"].of(1)] == [(0.5, 0.5), (1.5, 0.5)]
    assert RED_ONLY.of(1) == ()


RASTERS = {"rgb_stripe": 3, "bgr_stripe": 3, "rgb_column": 3, "pentile": 3, "led": 12, "even": 1, "own": 20}


@pytest.mark.parametrize("name", ALL)
def test_a_raster_is_as_coarse_as_fits_the_rectangles(name):
    assert ALL[name].raster == RASTERS[name]
    edges = [v for s in ALL[name].subpixels for v in s[1:]]
    fits = [n for n in range(1, RASTERS[name] + 1) if max(abs(v * n - round(v * n)) for v in edges) < 1e-6]
    assert fits == [RASTERS[name]]
    assert Layout(((0, 0.0137, 0.2, 0.777, 0.9001),)).raster == 24


@pytest.mark.parametrize("lit", [1.0, 0.25])
@pytest.mark.parametrize("name", ALL)
def test_coefficients_are_those_of_what_is_emitted(name, lit):
    """The discrete transform of the indicator, whose samples are constant on a lattice that holds every edge."""
    layout, n = ALL[name], 240  # 240 / 4 is a multiple of every raster, so half a subpixel's edges are on it, too
    (px, py), share = layout.period, torch.tensor(lit, dtype=torch.float64)
    y, x = torch.meshgrid(*((torch.arange(n * p).double() + 0.5) / n for p in (py, px)), indexing="ij")
    for channel in range(3):
        spectrum = torch.fft.fft2(emits(layout, channel, x, y, share)) / x.numel()
        for k, l in ((0, 0), (1, 0), (0, 1), (2, -1), (-3, 4), (5, 2)):
            sampled = torch.sinc(torch.tensor([k / (n * px), l / (n * py)], dtype=torch.float64)).prod()
            half = math.pi * (k / (n * px) + l / (n * py))  # samples lie half a step from the cell's corner
            wanted = spectrum[l, k] * sampled * torch.exp(torch.tensor(-1j * half))
            found = sum(
                coefficient(s, layout.period, k, l, lit)
                * torch.exp(torch.tensor(-2j * math.pi * (k * s.centre[0] / px + l * s.centre[1] / py)))
                for s in layout.of(channel)
            )
            assert abs(found - wanted) < 1e-6


def test_coefficients_of_a_stripe_are_the_textbooks():
    (red,) = LAYOUTS["rgb_stripe"].of(0)
    for k in range(1, 8):
        assert coefficient(red, (1, 1), k, 0, 1.0) == pytest.approx(math.sin(math.pi * k / 3) / (math.pi * k))


@pytest.mark.parametrize("layout", [OWN, RED_ONLY], ids=["own", "red only"])
def test_a_scene_with_a_layout_of_its_own_is_plain_data(layout):
    scene = Scene(panel=Panel(layout=layout, lit=(0.5, 0.9)))
    values = json.loads(json.dumps(scene.to_dict()))
    again = Scene.from_dict(values)
    assert again == scene and hash(again) == hash(scene) and again.panel.layout == layout
    assert pickle.loads(pickle.dumps(scene)) == scene
    assert Panel(layout={"subpixels": layout.subpixels, "period": layout.period}).layout == layout
    assert as_layout(values["panel"]["layout"]) == layout == as_layout(layout)
    shot = scene.sample(1, (4, 4))
    assert Shot.from_dict(json.loads(json.dumps(shot.to_dict()))).to_dict() == shot.to_dict()


@pytest.mark.parametrize("exposure", ["auto", "spectral", "box", "mean", "point", "supersample:3"])
@pytest.mark.parametrize("cfa", ["rggb", "none"])
def test_a_colour_that_a_layout_lacks_is_dark(cfa, exposure, images):
    sensor = Sensor(scale=2.0, cfa=cfa, exposure=exposure)
    scene = Scene(panel=Panel(layout=RED_ONLY), view=View(roll=5.0), sensor=sensor)
    shot = scene.sample(4, (24, 32))
    raw = expose(images, shot)
    assert (raw[:, 1:] == 0).all() and raw[:, 0].mean() > 0.1
    photo = capture(images, shot)
    assert (photo[:, 1:] == 0).all() and photo.isfinite().all()


@pytest.mark.parametrize("exposure", ["auto", "spectral", "box", "mean", "point", "supersample:3"])
def test_a_layout_of_ones_own_is_captured(exposure, images):
    """The mean over a picture is, to the alias at hand, the mean light of each colour's rectangles."""
    sensor = Sensor(scale=2.0, cfa="none", exposure=exposure)
    scene = Scene(panel=Panel(layout=OWN, scale=1.37), view=View(roll=3.0), lens=Lens(blur=0.3), sensor=sensor)
    photo = capture(torch.full_like(images, 0.9), scene.sample(4, (24, 32)))
    assert photo.mean((0, 2, 3)).tolist() == pytest.approx([0.9 * a for a in (0.25, 0.1, 0.125)], rel=0.02)


def variance_of(blur):
    """Of a point of light along x and y, in squared pixels, the mean over the places that it may have."""
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
    assert variance_of(lambda image: prefilter(image, wanted, 4)) == pytest.approx([variance] * 2, abs=1e-9)


def test_a_prefilter_blurs_each_place_by_its_own_variance():
    image = torch.rand(1, 3, 24, 32, dtype=torch.float64)
    variance = torch.zeros(1, 1, 24, 32, dtype=torch.float64)
    variance[..., 16:] = 4.0
    half = prefilter(image, variance, 3)
    assert torch.equal(half[..., :16], image[..., :16])
    assert torch.equal(half[..., 16:], prefilter(image, torch.full((1, 1, 1, 1), 4.0).double(), 3)[..., 16:])


@pytest.mark.parametrize(("across", "down"), [(0.0, 0.0), (0.2, 0.0), (0.5, 0.3)])
def test_a_spread_blurs_by_its_variance(across, down):
    v = torch.ones(16, 3, dtype=torch.float64)
    assert variance_of(lambda image: spread(image, across * v, down * v)) == pytest.approx([across, down], abs=1e-12)


@pytest.mark.parametrize("v", [0.2, 0.4, 0.5])
def test_a_spread_inverts_no_pattern(v):
    point, wanted = torch.zeros(1, 3, 16, 16, dtype=torch.float64), torch.full((1, 3), v, dtype=torch.float64)
    point[..., 8, 8] = 1
    transfer = torch.fft.fft2(torch.roll(spread(point, wanted, wanted), (-8, -8), (2, 3)))
    assert transfer.imag.abs().max() < 1e-12 and transfer.real.min() > -1e-12 and transfer.real.max() < 1 + 1e-12


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (2, 3)])
def test_what_blurs_keeps_a_flat_picture_of_any_size(size):
    flat, v = torch.full((1, 3, *size), 0.7, dtype=torch.float64), torch.full((1, 3), 0.4, dtype=torch.float64)
    for blurred in (spread(flat, v, v), prefilter(flat, 9 * v[..., None, None][:, :1], 4)):
        assert torch.allclose(blurred, flat, atol=1e-12)
