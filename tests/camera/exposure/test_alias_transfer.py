"""What is left of a harmonic in a binned reading, against the mean over sensor pixels that are
read, interpolated and averaged one by one."""

import itertools
import math

import pytest
import torch

from moireaug.camera.effects.demosaic import demosaic_bilinear
from moireaug.camera.exposure.alias_transfer import plane_waves, power_transfer

PIXELS = 6  # photo pixels along each axis, of which the outermost are not looked at
# what is farther away than four aliases: the fewer sensor pixels a photo pixel has, the more
NEAR = {1.0: 0.2, 1.5: 0.07, 2.0: 0.06, 2.5: 0.06, 3.7: 0.05, 6.2: 0.04, 9.0: 0.04, 16.0: 0.04}
FREQUENCIES = [(0.0, 0.0), (0.03, 0.0), (0.5, 0.02), (0.45, 0.51), (0.98, 0.07), (-1.3, 0.4)]


def wave(frequency, u, v):
    """A harmonic at sensor coordinates (h,) and (w,), complex."""
    fu, fv = frequency
    return torch.exp(2j * math.pi * (fu * u[None, :] + fv * v[:, None]))


def overlap(scale):
    """The shares of the sensor pixels in each photo pixel, (PIXELS, sensor pixels)."""
    n = math.ceil(scale * PIXELS)
    edge = torch.arange(n, dtype=torch.float64)
    first = torch.arange(PIXELS, dtype=torch.float64)[:, None] * scale
    return ((edge + 1).minimum(first + scale) - edge.maximum(first)).clamp(min=0) / scale


def brute_force(frequency, scale):
    """The three colours of every photo pixel, by a Bayer sensor's own pixels."""
    n = 2 * math.ceil(math.ceil(scale * PIXELS) / 2)
    at = torch.arange(n, dtype=torch.float64) + 0.5
    read = wave(frequency, at, at)
    colours = [demosaic_bilinear(part[None])[0] for part in (read.real, read.imag)]
    shares = overlap(scale)
    shares = torch.nn.functional.pad(shares, (0, n - shares.shape[1]))
    real, imaginary = (shares @ colour @ shares.mT for colour in colours)
    return torch.complex(real, imaginary)[:, 1:-1, 1:-1]


def closed_form(frequency, scale, colours=(0, 1, 2)):
    middle = (torch.arange(PIXELS, dtype=torch.float64) + 0.5) * scale
    centre = torch.stack(torch.meshgrid(middle, middle, indexing="xy"), -1)[None]
    sides = max(scale, 1.0) * torch.eye(2, dtype=torch.float64)
    fu, fv = (torch.full((1, 1, PIXELS, PIXELS), f, dtype=torch.float64) for f in frequency)
    read = plane_waves(fu, fv, centre, sides, 0.0, bayer=colours != (None,))
    found = []
    for colour in colours:
        real, imaginary = read[colour or 0]
        found.append(torch.complex(real, imaginary)[0, 0] * wave(frequency, middle, middle))
    return torch.stack(found)[:, 1:-1, 1:-1]


@pytest.mark.parametrize("scale", NEAR)
def test_four_aliases_are_the_mean_of_interpolated_pixels(scale):
    for frequency in FREQUENCIES:
        difference = closed_form(frequency, scale) - brute_force(frequency, scale)
        assert difference.abs().square().mean().sqrt() < NEAR[scale], frequency
    # negative control: red's closed form is not what the pixels of blue read
    frequency = (0.45, 0.02)
    swapped = closed_form(frequency, scale, (2, 1, 0)) - brute_force(frequency, scale)
    assert swapped[0].abs().square().mean().sqrt() > 0.3 * (scale in (3.7, 9.0))


@pytest.mark.parametrize("colours", [(0, 1, 2), (None,)])
def test_flat_light_is_read_as_it_is(colours):
    for scale in (0.01, 0.5, 1.0, 2.7, 150.0):
        flat = closed_form((0.0, 0.0), scale, colours)
        assert torch.allclose(flat, torch.ones_like(flat), atol=1e-12)


def test_without_colour_filters_a_wave_is_averaged_over_its_pixels():
    """A slow wave, held over each pixel and averaged over s of them: sinc(f) sinc(s f)."""
    f, s = 0.04, 5.0
    (found,) = closed_form((f, 0.0), s, (None,))
    middle = (torch.arange(PIXELS, dtype=torch.float64) + 0.5) * s
    left = math.prod(math.sin(math.pi * x) / (math.pi * x) for x in (f, s * f))
    expected = left * wave((f, 0.0), middle, middle)[1:-1, 1:-1]
    assert torch.allclose(found, expected, atol=0.02)


def test_aliases_change_without_a_step():
    """Where one of the four aliases gives way to the next, at twice a frequency that is whole."""
    for s, whole in itertools.product((0.4, 1.0, 2.3, 7.7), (-1.0, 0.0, 0.5, 1.0)):
        just_below, just_above = (closed_form((whole + d, 0.1), s) for d in (-1e-7, 1e-7))
        assert (just_below - just_above).abs().max() < 1e-4


def turned(degrees, long, short):
    """The two sides, (2, 2), of a slanted bin."""
    angle = math.radians(degrees)
    a = long * math.cos(angle), long * math.sin(angle)
    b = -short * math.sin(angle) + 0.3 * a[0], short * math.cos(angle) + 0.3 * a[1]
    return torch.tensor([[a[0], b[0]], [a[1], b[1]]], dtype=torch.float64)


@pytest.mark.parametrize("frequency", FREQUENCIES)
@pytest.mark.parametrize("shape", [(30, 5.0, 3.0), (-8, 9.0, 8.0), (80, 2.5, 6.0)])
def test_a_slanted_bin_is_the_mean_over_its_parallelogram(frequency, shape):
    """Bins of the image's frame lie anyhow on the sensor: a mean over points of the parallelogram
    of the pixels there, interpolated and held."""
    sides, n, at = turned(*shape), 48, torch.tensor([23.7, 24.4], dtype=torch.float64)
    pixels = torch.arange(n, dtype=torch.float64) + 0.5
    read = wave(frequency, pixels, pixels)
    colours = [demosaic_bilinear(part[None])[0] for part in (read.real, read.imag)]
    steps = (torch.arange(400, dtype=torch.float64) + 0.5) / 400 - 0.5
    u, v = (at[i] + sides[i, 0] * steps[:, None] + sides[i, 1] * steps for i in (0, 1))
    mean = [colour[:, v.long(), u.long()].mean((1, 2)) for colour in colours]
    f = [torch.full((1, 1, 1, 1), x, dtype=torch.float64) for x in frequency]
    waves = plane_waves(*f, at.reshape(1, 1, 1, 2), sides, 0.0, bayer=True)
    carrier = torch.exp(2j * math.pi * (frequency[0] * at[0] + frequency[1] * at[1]))
    for colour, (real, imaginary) in enumerate(waves):
        found = torch.complex(real, imaginary).flatten() * carrier
        assert (found - torch.complex(mean[0][colour], mean[1][colour])).abs() < 0.06


@pytest.mark.parametrize("frequency", FREQUENCIES)
def test_a_triangle_filter_is_a_mean_of_bins_around(frequency):
    """Of the bins whose middles lie in a bin."""
    n, sides = 60, turned(25, 5.0, 3.0)
    steps = (torch.arange(n, dtype=torch.float64) + 0.5) / n - 0.5
    across, down = torch.meshgrid(steps, steps, indexing="xy")
    middle = torch.tensor([23.7, 24.4], dtype=torch.float64)
    around = middle + across[..., None] * sides[:, 0] + down[..., None] * sides[:, 1]
    f = torch.tensor(frequency, dtype=torch.float64)

    def read(centre, again):
        size = centre.shape[1:3]
        given = [x.expand(1, 1, *size) for x in f]
        waves = plane_waves(*given, centre, sides, again, bayer=True)
        carrier = torch.exp(2j * math.pi * (centre * f).sum(-1))
        return [(torch.complex(*wave)[0] * carrier).mean() for wave in waves]

    expected = read(around[None], 0.0)
    at = middle.reshape(1, 1, 1, 2)
    for found, mean, plain in zip(read(at, 1.0), expected, read(at, 0.0), strict=True):
        assert (found - mean).abs() < 1e-3
        assert found.abs() <= plain.abs() + 1e-9


def test_the_power_transfer_is_that_of_bins_anywhere():
    frequency, sides = (0.46, 0.02), turned(20, 4.0, 3.0)
    draw = torch.Generator().manual_seed(0)
    centre = 40 * torch.rand(1, 60, 60, 2, dtype=torch.float64, generator=draw)
    f = [torch.full((1, 1, 60, 60), x, dtype=torch.float64) for x in frequency]
    for bayer in (True, False):
        waves = plane_waves(*f, centre, sides, 0.0, bayer=bayer)
        left = power_transfer(f[0][:, :, 0, 0], f[1][:, :, 0, 0], sides[None], 0.0, bayer=bayer)
        for (real, imaginary), share in zip(waves, left, strict=True):
            mean = (real.square() + imaginary.square()).mean()
            assert float(mean) == pytest.approx(float(share), abs=0.02)


@pytest.mark.parametrize(
    ("frequency", "shape"),
    [([0.5, 0.0, 0.47], (0, 3.0, 2.0)), ([0.48, 0.03, 0.47], (10, 3.0, 2.6))],
    ids=["standing beats", "slanted bin"],
)
def test_a_beat_has_a_gradient(frequency, shape):
    """At frequency zero, too. In a bin of no whole number of pixels, the fifth alias would change
    the slope there by a few thousandths."""
    f = torch.tensor(frequency, dtype=torch.float64, requires_grad=True)
    sides = turned(*shape)
    if shape[0] == 0:
        sides = torch.diag(sides.diagonal())
    sides.requires_grad_()
    centre = torch.tensor([4.5, 7.2], dtype=torch.float64, requires_grad=True)

    def waves(f, sides, centre):
        f = f.reshape(3, 1, 1, 1)
        found = plane_waves(f, 0.3 * f, centre.reshape(1, 1, 1, 2), sides, 0.6, bayer=True)
        return tuple(part for wave in found for part in wave)

    assert torch.autograd.gradcheck(waves, (f, sides, centre))
