"""The Fourier series of a unit cell against the mask that it stands for."""

import math

import pytest
import torch

from moireaug import Panel, Scene
from moireaug.camera.panel import coefficient, emits, emitting_share, mean_light, own_orders
from moireaug.scene.layout import LAYOUTS, Layout

OWN = Layout(((0, 0.0, 0.0, 0.5, 1.0), (1, 0.5, 0.0, 1.0, 0.4), (2, 1.25, 0.5, 1.75, 1.0)), (2, 1))
RED_AND_GREEN = (0, 0.5, 0.5, 0.4, 0.2, -0.1, 0.6), (1, 0.9, 0.1, 0.3, 0.0, 0.2, 0.5)
SLANTED = Layout((*RED_AND_GREEN, (2, 1.5, 0.5, 0.5, 0.5, -0.5, 0.5)), (2, 1))
MIRRORED = Layout(
    tuple((c, cx, cy, ax, -ay, -dx, dy) for c, cx, cy, ax, ay, dx, dy in SLANTED.subpixels), (2, 1)
)
PAIRS = ((0, 0), (1, 0), (0, 1), (2, -1), (-3, 4), (5, 2))

# of layouts whose edges lie between samples, as those of the parallelograms below
BOUNDS = dict.fromkeys(("chevron", "pentile_diamond", "oled_triangle", "led_cob"), 1e-3)


def number(x):
    return torch.tensor(x, dtype=torch.float64)


def sampled(layout, channel, n, width, height):
    """Coefficients of a channel's mask by its discrete transform, n samples a panel pixel."""
    px, py = layout.period
    rows, cols = ((torch.arange(n * p).double() + 0.5) / n for p in (py, px))
    y, x = torch.meshgrid(rows, cols, indexing="ij")
    mask = sum(emits(s, x, y, width, height) for s in layout.of(channel))
    spectrum, found = torch.fft.fft2(mask) / x.numel(), {}
    for k, l in PAIRS:
        held = torch.sinc(number([k / (n * px), l / (n * py)])).prod()
        # samples lie half a step from the cell's corner
        half = math.pi * (k / (n * px) + l / (n * py))
        found[k, l] = spectrum[l, k] * held * torch.exp(torch.tensor(-1j * half))
    return found


def in_closed_form(layout, channel, k, l, width, height):
    total = 0.0
    for s in layout.of(channel):
        own_k, own_l, has = own_orders(s, layout, k, l)
        if has:
            turns = own_k * s.centre[0] / s.period[0] + own_l * s.centre[1] / s.period[1]
            c = coefficient(s, own_k, own_l, width, height)
            total = total + c * torch.exp(torch.tensor(-2j * math.pi * turns))
    return total


@pytest.mark.parametrize(("width", "height"), [(1.0, 1.0), (0.75, 0.5)])
@pytest.mark.parametrize("name", [*LAYOUTS, "own"])
def test_coefficients_are_those_of_what_is_emitted(name, width, height):
    """The mask's samples are constant on a lattice that holds every edge."""
    layout = OWN if name == "own" else LAYOUTS[name]
    for channel in range(3):
        # 240 / 8 is a multiple of every raster, so that edges after a share of eighths are on the
        # lattice, too
        wanted = sampled(layout, channel, 480, number(width), number(height))
        for k, l in PAIRS:
            found = in_closed_form(layout, channel, k, l, number(width), number(height))
            assert abs(found - wanted[k, l]) < BOUNDS.get(name, 1e-6)


@pytest.mark.parametrize(("width", "height"), [(1.0, 1.0), (0.6, 0.9)])
@pytest.mark.parametrize("channel", range(3))
def test_coefficients_of_parallelograms_are_those_of_what_is_emitted(channel, width, height):
    width, height = number(width), number(height)
    wanted = sampled(SLANTED, channel, 500, width, height)
    assert max(abs(wanted[pair]) for pair in PAIRS[1:]) > 0.02
    differences = []
    for layout in (SLANTED, MIRRORED):
        found = {(k, l): in_closed_form(layout, channel, k, l, width, height) for k, l in PAIRS}
        differences.append(max(abs(found[pair] - wanted[pair]) for pair in PAIRS))
    assert differences[0] < 5e-4
    if channel < 2:  # blue's is its own mirror image
        assert differences[1] > 0.01


def test_a_gapped_row_has_the_harmonics_of_a_pulse():
    """Of a stripe 1/3 wide and 1 high, lit_x goes to the width, lit_y to the height and the root of
    lit to both."""
    shot = Scene(panel=Panel(lit=0.81, lit_x=0.5, lit_y=0.8)).sample(1, (4, 4))
    width, height = emitting_share(shot.panel)
    assert (width.item(), height.item()) == pytest.approx((0.45, 0.72))
    (red,) = LAYOUTS["rgb_stripe"].of(0)
    for k, l in PAIRS:
        expected = math.prod(torch.sinc(number([k * 0.15, l * 0.72])).tolist()) * 0.15 * 0.72
        assert coefficient(red, k, l, width, height).item() == pytest.approx(expected)
    light = mean_light(LAYOUTS["rgb_stripe"], width, height)[0]
    assert light.tolist() == pytest.approx([0.15 * 0.72] * 3)
