"""The curves that kernels compute without transcendental functions."""

import numba
import numpy as np
import pytest

from moireaug.engine.cpu import srgb


@pytest.fixture(scope="module")
def encoded():
    @numba.njit(error_model="numpy")
    def fill(code, again, slope, light):
        for i in range(len(light)):
            code[i] = srgb.encode(light[i])
            again[i], slope[i] = srgb.encode_and_slope(light[i])

    def encoded(light):
        light = np.asarray(light, np.float32)
        code, again, slope = (np.empty_like(light) for _ in range(3))
        fill(code, again, slope, light)
        assert np.array_equal(code, again)
        return code, slope

    return encoded


def test_encoding_and_its_slope_are_those_of_srgb(encoded):
    light = np.concatenate([np.linspace(-0.5, 1.5, 20001), np.geomspace(1e-3, 256, 20001)])
    light = light.astype(np.float32)
    code, slope = encoded(light)
    exact = light.astype(np.float64)
    bright, above = exact > srgb.SRGB_KNEE, np.maximum(exact, srgb.SRGB_KNEE)
    codes = np.where(bright, 1.055 * above ** (1 / 2.4) - 0.055, 12.92 * exact)
    slopes = np.where(bright, 1.055 / 2.4 * above ** (1 / 2.4 - 1), 12.92)
    assert (np.abs(code - codes) < 5e-6 * np.maximum(np.abs(codes), 1)).all()
    assert (np.abs(slope - slopes) < 5e-6 * slopes).all()


def test_full_light_is_not_encoded_above_full_scale(encoded):
    # there, a clip's slope would be 0 instead of 1
    code, _ = encoded(1 - np.arange(1000) * 2.0**-24)
    assert (code <= 1).all()
    assert code[0] > 1 - 1e-6
