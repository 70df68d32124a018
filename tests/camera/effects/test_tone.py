"""White balance, colour matrix and tone curve."""

import pytest
import torch

from moireaug.camera.effects.tone import (
    CONTRAST_PER_CODE,
    balance,
    colour_matrix,
    shoulder_shift,
    tone_curve,
)
from moireaug.camera.exposure.filters import crosstalk_matrix


def numbers(*values):
    return torch.tensor(values, dtype=torch.float64)


def test_balance_leaves_green_alone():
    photo, red, blue = torch.rand(2, 3, 4, 5), numbers(1.5, 0.5), numbers(1.0, 2.0)
    out = balance(photo, red, blue)
    assert out.dtype == photo.dtype and torch.equal(out[:, 1], photo[:, 1])
    assert torch.allclose(out[:, 0], red.float()[:, None, None] * photo[:, 0])
    assert torch.allclose(out[:, 2], blue.float()[:, None, None] * photo[:, 2])


CROSSTALK = numbers(0.0, 0.1, 0.2, 0.3)


def test_grey_stays_grey():
    for saturation in (0.0, 0.6, 1.0, 4.0):
        matrix = colour_matrix(CROSSTALK, torch.full_like(CROSSTALK, saturation))
        assert torch.allclose(matrix.sum(2), torch.ones(4, 3).double(), atol=1e-12)


def test_the_colour_matrix_undoes_the_crosstalk():
    matrix = colour_matrix(CROSSTALK, torch.ones_like(CROSSTALK))
    whole = matrix @ crosstalk_matrix(CROSSTALK)
    assert torch.allclose(whole, torch.eye(3).double().expand(4, 3, 3), atol=1e-12)
    # negative control: of another sensor it does not
    other = matrix[1:] @ crosstalk_matrix(CROSSTALK)[:-1]
    assert (other - torch.eye(3).double()).abs().amax((1, 2)).min() > 0.1


@pytest.mark.parametrize("crosstalk", [0.0, 0.3])
def test_without_saturation_a_photo_is_its_brightness(crosstalk):
    """And twice as much takes every colour twice as far from it."""
    scene_colours = torch.rand(3, 20, dtype=torch.float64)
    seen = crosstalk_matrix(numbers(crosstalk))[0] @ scene_colours
    grey = scene_colours.mean(0)
    for saturation in (0.0, 1.0, 2.0):
        out = colour_matrix(numbers(crosstalk), numbers(saturation))[0] @ seen
        assert torch.allclose(out, grey + saturation * (scene_colours - grey), atol=1e-12)


CONTRASTS = numbers(-1.0, -0.4, 0.0, 0.7, 1.0)
SHOULDERS = numbers(0.0, 0.3, 1.0, 4.0, 10.0)
NONE = torch.zeros_like(CONTRASTS)
CODES = torch.linspace(0, 1, 10001, dtype=torch.float64).expand(5, 1, 1, -1)


def test_contrast_never_falls_and_keeps_both_ends_and_the_middle():
    out = tone_curve(CODES, CONTRASTS, NONE)
    assert (out.diff() >= -1e-15).all()
    assert out[..., [0, 5000, 10000]].tolist() == [[[[0.0, 0.5, 1.0]]]] * 5
    assert torch.equal(out[2], CODES[2])
    x = CODES[0]
    assert torch.allclose(out[4], x * x * (3 - 2 * x))  # the smoothstep
    # positive contrast is steep in the middle, negative at both ends
    assert (out[3:, ..., 5001] > CODES[3:, ..., 5001]).all()
    assert (out[:2, ..., 5001] < CODES[:2, ..., 5001]).all()


def test_a_shoulder_lifts_the_middle_and_rolls_off_the_highlights():
    out = tone_curve(CODES, NONE, SHOULDERS)
    assert (out[1:].diff() > 0).all()
    assert torch.equal(out[0], CODES[0])
    assert out[..., [0, 10000]].tolist() == [[[[0.0, 1.0]]]] * 5
    slopes = out.diff() * 10000
    assert slopes[..., 0].flatten().tolist() == pytest.approx((1 + SHOULDERS).tolist(), rel=2e-3)
    ends = (1 / (1 + SHOULDERS)).tolist()
    assert slopes[..., -1].flatten().tolist() == pytest.approx(ends, rel=2e-3)
    # two shoulders a and b after each other are one of a + b + a b
    once = tone_curve(CODES[:1], numbers(0), numbers(0.5))
    twice = tone_curve(once, numbers(0), numbers(2.0))
    assert torch.allclose(twice, tone_curve(CODES[:1], numbers(0), numbers(3.5)), atol=1e-14)


def test_contrast_comes_after_the_shoulder():
    out = tone_curve(CODES, CONTRASTS, SHOULDERS)
    lifted = tone_curve(CODES, NONE, SHOULDERS)
    assert torch.allclose(out, tone_curve(lifted, CONTRASTS, NONE), atol=1e-15)
    # negative control: the other way round is another curve
    other = tone_curve(tone_curve(CODES, CONTRASTS, NONE), NONE, SHOULDERS)
    assert (out - other)[[1, 3, 4]].abs().amax((1, 2, 3)).min() > 0.01


def test_more_contrast_than_allowed_falls():
    """Negative control: the bounds of the field are those of a curve that never falls."""
    for contrast in (-2.1, 1.1):
        assert tone_curve(CODES[:1], numbers(contrast), numbers(0)).diff().min() < 0


def test_the_tone_curve_moves_codes_as_the_plan_expects():
    moved = (tone_curve(CODES, CONTRASTS, NONE) - CODES).abs().amax((1, 2, 3))
    assert moved.tolist() == pytest.approx((CONTRASTS.abs() / CONTRAST_PER_CODE).tolist(), rel=1e-6)
    moved = (tone_curve(CODES, NONE, SHOULDERS) - CODES).abs().amax((1, 2, 3))
    expected = [shoulder_shift(s) for s in SHOULDERS.tolist()]
    assert moved.tolist() == pytest.approx(expected, rel=1e-6)


def test_codes_past_the_ends_are_clipped_first():
    outside = torch.tensor([-0.3, 1.2]).reshape(1, 1, 1, 2)
    assert tone_curve(outside, numbers(0.8), numbers(2.0)).flatten().tolist() == [0.0, 1.0]


def test_gradients_of_matrix_and_curve():
    photo = torch.rand(2, 3, 2, 2, dtype=torch.float64) * 0.8 + 0.1
    crosstalk, saturation, contrast = numbers(0.1, 0.2), numbers(0.7, 1.3), numbers(-0.5, 0.8)
    shoulder = numbers(0.2, 3.0)
    for given in (photo, crosstalk, saturation, contrast, shoulder):
        given.requires_grad_()
    assert torch.autograd.gradcheck(colour_matrix, (crosstalk, saturation))
    assert torch.autograd.gradcheck(tone_curve, (photo, contrast, shoulder))
