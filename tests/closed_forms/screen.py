"""Closed forms of the screen: moiré and the picture that carries it. A check asserts them in one
dtype."""

import dataclasses
import functools
import itertools
import math

import numpy as np
import pytest
import torch

from moireaug import Develop, Lens, Panel, Scene, Sensor, View, expose
from moireaug.scene.geometry import grids
from moireaug.scene.geometry.lattice import CFA
from moireaug.scene.layout import LAYOUTS
from tests.closed_forms.common import CELL, CLOSE, EVEN, read, sinc

SITES = CFA["rggb"]
# layouts of rectangles that a coarse raster holds: what points, boxes and few samples say exactly
RASTERED = ("rgb_stripe", "bgr_stripe", "rgb_column", "pentile", "wrgb", "led", "even")
STEEP = math.degrees(math.atan(3 / 4))  # of cosine 4/5 and sine 3/5


def red_spectrum(scene, n, dtype):
    """Fourier coefficients of the red plane that n x n white pixels give, frequencies along v
    first."""
    return torch.fft.fft2(read(scene, (n, n), dtype)[0]) / n**2


# -- moiré


def check_alias(dtype):
    """Harmonic (k, l) of the panel shows at J^T (k, l), folded to the red pixels' lattice, with |a|
    times the MTF."""
    n, fill, blur, olpf, side, close = 64, 0.8, 0.08, 0.3, 0.9, CLOSE[dtype] / 10
    red = {  # width and height of the red subpixel, and some harmonics
        "rgb_stripe": (1 / 3, 1, ((1, 0), (2, 0), (4, 0))),
        "rgb_column": (1, 1 / 3, ((0, 1), (0, 2), (0, 4))),
        "led": (1 / 2, 1 / 6, ((1, 0), (0, 1), (1, -1))),
    }
    turns = (
        (View(), 1.0, 0.0),
        (View(roll=STEEP, fit=False), 0.8, 0.6),
        (View(roll=-STEEP, zoom=1.25, fit=False), 0.8, -0.6),
    )
    sensor, lens = Sensor(scale=2.0, fill=fill, exposure="spectral"), Lens(blur=blur, olpf=olpf)
    for layout, (w, h, harmonics) in red.items():
        for turn, c, s in turns:
            panel = Panel(layout=layout, lit=side**2, scale=95 / n * turn.zoom)
            scene = Scene(panel=panel, view=turn, lens=lens, sensor=sensor, tolerance=1e-5)
            spectrum = red_spectrum(scene, n, dtype)
            for k, l in harmonics:
                # cycles over n red pixels: whole
                across, down = 95 * (c * k + s * l), 95 * (c * l - s * k)
                fu, fv = across / (2 * n), down / (2 * n)  # cycles per sensor pixel
                a = w * h * side**2 * sinc(k * w * side) * sinc(l * h * side)
                mtf = math.exp(-2 * (math.pi * blur) ** 2 * (fu * fu + fv * fv))
                for f in (fu, fv):
                    mtf *= sinc(fill * f) * math.cos(math.pi * olpf * f)
                assert abs(a * mtf) > 50 * close
                seen = spectrum[round(down) % n, round(across) % n].abs()
                assert abs(seen - abs(a * mtf)) < close


def check_whole_pitches(dtype):
    """An aperture as wide as a whole number of pitches sees no contrast."""
    fills = (2.5, 0.8, True), (4.5, 8 / 9, True), (2.5, 0.7, False), (4.5, 1.0, False)
    for exposure in ("spectral", "box"):
        for alpha, fill, whole in fills:
            sensor = Sensor(scale=2.0, fill=fill, exposure=exposure)
            scene = Scene(panel=Panel(scale=alpha), sensor=sensor, tolerance=1e-7)
            contrast = read(scene, (2, 63), dtype)[0].std()
            assert contrast < CLOSE[dtype] if whole else contrast > 1e-3


def check_mean_light(dtype):
    """Over all phases of the panel, 31 along each axis. Points do not integrate, so `point` has no
    such form."""
    for layout in (*LAYOUTS, CELL):
        cell = Panel(layout=layout).cell
        area = [sum(s.density for s in cell.of(site.channels[0])) for site in SITES]
        bounds = {"mean": 1e-5, "spectral": 1e-5}
        if layout in (*RASTERED, CELL):
            bounds["box"] = 1e-5
        if layout in ("rgb_stripe", CELL):
            bounds["supersample:4"] = 0.02
        for method, bound in bounds.items():
            panel = Panel(layout=layout, lit=0.6, scale=44 / 31)
            sensor = Sensor(scale=2.0, exposure=method)
            mean = read(Scene(panel=panel, sensor=sensor), (31, 31), dtype).mean((1, 2))
            assert mean.tolist() == pytest.approx([0.6 * a for a in area], rel=bound)


def overlap(centre, reach, start, width, period):
    """How much of [centre - reach, centre + reach] lies in the copies of [start, start + width],
    one each period."""
    left = start + period * np.arange(-200, 200)
    low = np.maximum(centre[:, None] - reach, left)
    high = np.minimum(centre[:, None] + reach, left + width)
    return np.clip(high - low, 0, None).sum(1)


def check_box(dtype):
    """Frontal and sharp, a reading is the exact overlap of subpixels and aperture."""
    size, scale, fill, lit = (8, 12), 3.0, 0.9, 0.7
    for layout in (*RASTERED, CELL):
        for alpha in (0.31, 1.7):
            panel = Panel(layout=layout, lit=lit, scale=alpha)
            sensor = Sensor(scale=scale, fill=fill, exposure="box")
            raw = read(Scene(panel=panel, sensor=sensor, tolerance=1e-6), size, dtype)
            # of sensor pixels, on the panel
            centres = [(np.arange(n * scale) + 0.5) * alpha / scale for n in size]
            reach, cell = fill / 2 * alpha / scale, Panel(layout=layout).cell
            for plane, (r, c, (channel,)) in zip(raw, SITES, strict=True):
                light = 0
                for s in cell.of(channel):
                    widths = s.across[0] * lit**0.5, s.down[1] * lit**0.5
                    sides = [(o - w / 2, w) for o, w in zip(s.centre, widths, strict=True)]
                    down = overlap(centres[0], reach, *sides[1], s.period[1])[r::2]
                    across = overlap(centres[1], reach, *sides[0], s.period[0])[c::2]
                    light = light + down[:, None] * across / (2 * reach) ** 2
                assert np.abs(plane.numpy() - light).max() < 1e-6


def check_point(dtype):
    """A reading is bilinear in a raster of subpixels, as few as their edges allow and each of one
    value."""
    n, scale, lit = 8, 2.5, 0.6
    for layout in (*RASTERED, CELL):
        for alpha in (1.3, 4.0):
            panel = Panel(layout=layout, lit=lit, scale=alpha)
            sensor = Sensor(scale=scale, exposure="point")
            raw = read(Scene(panel=panel, sensor=sensor, tolerance=1e-6), (n, n), dtype)
            cell = Panel(layout=layout).cell
            # of sensor pixels, on the raster
            at = ((np.arange(n * scale) + 0.5) * alpha / scale) * cell.raster - 0.5
            left = np.floor(at).astype(int)
            width, height = (cell.raster * period for period in cell.period)
            for plane, (r, c, (channel,)) in zip(raw, SITES, strict=True):
                raster = np.zeros((height, width))
                for colour, *sides in cell.subpixels:
                    x0, y0, x1, y1 = (round(v * cell.raster) for v in sides)
                    raster[y0:y1, x0:x1] += colour == channel
                light = 0
                for y, x in np.ndindex(2, 2):
                    down, across = (np.abs(1 - k - (at - left))[i::2] for k, i in ((y, r), (x, c)))
                    cells = np.ix_((left[r::2] + y) % height, (left[c::2] + x) % width)
                    light = light + np.outer(down, across) * raster[cells]
                assert np.abs(plane.numpy() - lit * light).max() < 1e-6


MAGNIFIED = Scene(
    panel=Panel(scale=0.3, layout="pentile", lit=0.8), sensor=Sensor(scale=2.0), tolerance=1e-4
)
MINIFIED = dataclasses.replace(MAGNIFIED, panel=Panel(scale=1.3, layout=CELL, lit=0.8))


def from_everywhere(scene, exposure, dtype):
    """The raw reading of three flat screens, seen from three places through bent and blurred
    lenses."""
    scene = dataclasses.replace(
        scene,
        view=View(yaw=(-25, 25), pitch=(-10, 10), roll=(-30, 30)),
        lens=Lens(blur=0.25, olpf=0.4, k1=(0, 0.05)),
        sensor=Sensor(scale=2.0, exposure=exposure),
    )
    shot = scene.sample(3, (8, 8), torch.Generator().manual_seed(0))
    return expose(torch.full((3, 3, 8, 8), 0.7, dtype=dtype), shot).double()


@functools.cache
def brute_force(scene, n):
    return from_everywhere(scene, f"supersample:{n}", torch.float64)


def check_supersampling(dtype):
    """Spectral is exact in any view; box, for magnified screens, to the Gaussian that stands for
    what is not a box."""
    cases = ("spectral", MINIFIED, 0.02, 10), ("box", MAGNIFIED, 0.015, 2)
    for method, scene, bound, gain in cases:
        ours = from_everywhere(scene, method, dtype)
        errors = [(ours - brute_force(scene, n)).square().mean().sqrt() for n in (4, 24)]
        coarse, fine = (error / ours.max() for error in errors)
        assert fine < bound and fine < coarse / gain


# -- the picture


def check_held_picture(dtype):
    """Six sensor pixels a panel pixel, two a stripe: every other reading of a colour lies wholly
    inside a subpixel."""
    # plane, and where the left and the right panel pixel are read
    places = (0, 0, 3), (1, 1, 4), (2, 1, 4), (3, 2, 5)
    for exposure in ("spectral", "box", "supersample:3"):
        scene = Scene(sensor=Sensor(scale=6.0, exposure=exposure))
        pictures = torch.tensor([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], dtype=dtype)
        pictures = pictures[:, None, None].expand(-1, 3, 4, -1)
        left, right, both = expose(pictures, scene.sample(3, (4, 2)))
        for plane, a, b in places:
            for own, other, here in ((left, right, a), (right, left, b)):
                assert (own - both)[plane, :, here].abs().max() < CLOSE[dtype]
                assert other[plane, :, here].abs().max() < CLOSE[dtype]
            # the series is cut at the tolerance
            assert (both[plane, :, [a, b]] - 1).abs().max() < 0.02


FAR = (  # one reading spans more than 8 image pixels everywhere, or at the far end
    View(zoom=0.1, fit=False),
    View(zoom=0.1, roll=30.0, fit=False),
    View(yaw=60.0, zoom=0.25, fov=60.0, fit=False),
)


def check_checkerboard_from_afar(dtype):
    """Squares of one or two pixels, eight pixels and more to a reading, are grey: no alias."""
    n = 95  # odd, so that the last row and column count twice where the picture is halved
    lines = torch.arange(n)
    boards = [(lines[:, None] // side + lines // side) % 2 for side in (1, 2, 1)]  # of each colour
    for exposure, turn in itertools.product(("spectral", "box", "mean"), FAR):
        sensor = Sensor(cfa="none", exposure=exposure)
        scene = Scene(panel=EVEN, view=turn, sensor=sensor, develop=Develop(registered=False))
        shot = scene.sample(1, (n, n))
        raw = expose(torch.stack(boards).to(dtype)[None], shot)[0]
        inverse, points = torch.linalg.inv(shot.matrix()), grids.pixel_centres((n, n), raw.device)
        x, y = grids.photo_to_image(points, inverse, (n, n), None).unbind(-1)
        span = grids.jacobian(points, inverse, (n, n), None).norm(dim=-1).amax(-1)
        far = ((x.sub(n / 2).abs() < 36) & (y.sub(n / 2).abs() < 36) & (span > 8))[0]
        assert far.sum() > 30
        assert (raw[:, far] - 0.5).abs().max() < 0.005
