"""What a sensor pixel sees of the cells around it, against the closed form in float64."""

import math

import numba
import numpy as np
import pytest

from moireaug.camera.exposure.footprint import NEAREST_GUARD_SHARE
from moireaug.engine.cpu import tap_weights

RADIUS, TAPS = 2, 8
PHASES = np.array([48, 512])


@pytest.fixture(scope="module")
def filled():
    @numba.njit(error_model="numpy")
    def fill(out, blur, widths, phases, farthest):
        most = (2 * RADIUS + 1) * phases.max() // 2 + 1
        scratch = tap_weights.Scratch(
            np.empty(most + 2 * tap_weights.cubic_margin(farthest * phases.max())),
            np.empty(most),
            np.empty(phases.max() // 2 + 1),
        )
        tap_weights.fill_node(out, blur, widths, RADIUS, phases, TAPS, scratch)

    def filled(box, sigma, width):
        """Return the weights, (phases + 2, taps) along each axis."""
        out = np.full((PHASES.sum() + 4) * TAPS, np.nan, np.float32)
        blur, widths = np.array([[box, sigma]] * 2), np.array([width] * 2)
        fill(out, blur, widths, PHASES, max(RADIUS + 0.5, width / 2))
        along_x, along_y = np.split(out, [(PHASES[0] + 2) * TAPS])
        return along_x.reshape(-1, TAPS), along_y.reshape(-1, TAPS)

    return filled


def light(x, box, sigma, width):
    """Return the light from a subpixel at distance x: box, Gaussian and subpixel convolved."""

    def integral(x):
        z = x / sigma
        density = math.exp(-z * z / 2) / math.sqrt(2 * math.pi)
        return sigma * (z * math.erfc(-z / math.sqrt(2)) / 2 + density)

    far, near = (box + width) / 2, (box - width) / 2
    return integral(x + far) - integral(x + near) - integral(x - near) + integral(x - far)


def exact(phases, box, sigma, width):
    """Return the weights that `filled` should have."""
    out = np.zeros((phases + 2, TAPS))
    for row in range(phases + 2):
        at = (row - (row > phases // 2)) / phases - 0.5  # distance 0 is there twice
        first = -TAPS // 2 + (row > phases // 2)
        for j in range(TAPS):
            if abs(first + j) <= RADIUS:
                # the guard, where no cell is seen
                guard = NEAREST_GUARD_SHARE * box * (first + j == 0)
                out[row, j] = max(light(first + j - at, box, sigma, width), 0) + guard
        out[row] /= out[row].sum()
    return out


@pytest.mark.parametrize(
    ("box", "sigma", "close"),
    [
        (0.5, 0.4, 3e-5),
        (0.3, 0.15, 3e-5),
        (1.9, 1.2, 3e-5),
        (4.0, 0.3, 3e-5),
        (1e-6, 0.4, 2e-4),  # of what is left of digits that cancel
        (0.9, 0.02, 2e-3),  # more than 48 phases are taken where light is blurred as little
    ],
)
def test_tap_weights_are_the_closed_form(filled, box, sigma, close):
    for width in (0.1, 1 / 3, 1.0):
        for phases, got in zip(PHASES, filled(box, sigma, width), strict=True):
            np.testing.assert_allclose(got, exact(phases, box, sigma, width), atol=close)
