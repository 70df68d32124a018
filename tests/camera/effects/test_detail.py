"""Chroma blur and unsharp mask: each leaves alone what it must, and filters a wave as a Gaussian
does."""

import functools
import math

import pytest
import torch

from moireaug.camera.effects.detail import brightness, chroma_blur, gaussian, kernel_size, sharpen

SIZES = [(1, 1), (1, 7), (9, 1), (5, 6)]
EXACT = {"atol": 1e-12, "rtol": 0}


def numbers(*values):
    return torch.tensor(values, dtype=torch.float64)


def photos(*size):
    return torch.rand(2, 3, *size, dtype=torch.float64)


SIGMAS = numbers(0.7, 1.6)


def wave(frequency, n=96):
    """Rows of a wave (1, 1, 3, n) about 0, and the columns that no border reaches."""
    across = torch.arange(n, dtype=torch.float64)
    return torch.cos(2 * math.pi * frequency * across).expand(1, 1, 3, n), slice(24, -24)


@pytest.mark.parametrize("sigma", [0.7, 1.0, 2.0])
@pytest.mark.parametrize("frequency", [0.05, 0.125, 0.25])
def test_a_gaussian_attenuates_a_wave(sigma, frequency):
    """By exp(-2 pi^2 sigma^2 f^2), to what lies past three standard deviations and what a kernel
    of whole pixels aliases."""
    row, inside = wave(frequency)
    out = gaussian(row, numbers(sigma), kernel_size(sigma))
    passed = math.exp(-2 * math.pi**2 * sigma**2 * frequency**2)
    assert torch.allclose(out[..., inside], passed * row[..., inside], atol=0.012)


@pytest.mark.parametrize("sigma", [1e-6, 0.3, 1.0, 20.0])
def test_a_kernel_holds_three_standard_deviations(sigma):
    size = kernel_size(sigma)
    assert size % 2 == 1 and size >= 3
    assert (size - 1) / 2 >= 3 * sigma > (size - 1) / 2 - 1


@pytest.mark.parametrize("size", SIZES)
def test_chroma_blur_leaves_brightness_and_sharpening_colour(size):
    photo = photos(*size)
    blurred = chroma_blur(photo, SIGMAS, kernel_size(1.6))
    torch.testing.assert_close(brightness(blurred), brightness(photo), **EXACT)
    sharp = sharpen(photo, numbers(0.5, 2.0), SIGMAS, kernel_size(1.6))
    colour = photo - brightness(photo)
    torch.testing.assert_close(sharp - brightness(sharp), colour, **EXACT)
    for out in (blurred, sharp):
        assert size == (1, 1) or (out - photo).abs().max() > 0.05


def test_chroma_blur_attenuates_a_wave_of_colour():
    row, inside = wave(0.125)
    photo = 0.5 + 0.1 * torch.cat([row, -row, 0 * row], 1)
    out = chroma_blur(photo, numbers(1.0), kernel_size(1.0)) - 0.5
    passed = math.exp(-2 * math.pi**2 * 0.125**2)
    wanted = passed * (photo - 0.5)
    assert torch.allclose(out[..., inside], wanted[..., inside], atol=1e-3)
    grey = 0.5 + 0.1 * row.expand(-1, 3, -1, -1)
    torch.testing.assert_close(chroma_blur(grey, numbers(1.0), kernel_size(1.0)), grey, **EXACT)


def test_sharpening_amplifies_a_wave_of_brightness():
    row, inside = wave(0.125)
    photo = 0.5 + 0.1 * row.expand(-1, 3, -1, -1)
    out = sharpen(photo, numbers(1.5), numbers(1.0), kernel_size(1.0)) - 0.5
    gain = 1 + 1.5 * (1 - math.exp(-2 * math.pi**2 * 0.125**2))
    wanted = gain * (photo - 0.5)
    assert torch.allclose(out[..., inside], wanted[..., inside], atol=1e-3)


@pytest.mark.parametrize("colour", [(0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (0.9, 0.2, 0.4)])
def test_flat_stays_flat(colour):
    for size in SIZES:
        flat = numbers(*colour)[:, None, None].expand(2, 3, *size)
        torch.testing.assert_close(chroma_blur(flat, SIGMAS, 11), flat, **EXACT)
        torch.testing.assert_close(sharpen(flat, numbers(1.0, 9.0), SIGMAS, 11), flat, **EXACT)


def test_none_is_none():
    photo = photos(6, 8)
    torch.testing.assert_close(chroma_blur(photo, numbers(0.0, 0.0), 5), photo, **EXACT)
    assert torch.equal(sharpen(photo, numbers(0.0, 0.0), SIGMAS, 11), photo)


def test_each_photo_has_its_own_filter():
    photo = photos(8, 9)
    amounts = numbers(0.3, 2.0)
    whole = chroma_blur(photo, SIGMAS, 11), sharpen(photo, amounts, SIGMAS, 11)
    for i in range(2):
        one = slice(i, i + 1)
        blurred = chroma_blur(photo[one], SIGMAS[one], 11)
        sharp = sharpen(photo[one], amounts[one], SIGMAS[one], 11)
        torch.testing.assert_close(blurred, whole[0][one], **EXACT)
        torch.testing.assert_close(sharp, whole[1][one], **EXACT)
    # and differs from the other's
    swapped = chroma_blur(photo, SIGMAS.flip(0), 11)
    assert (swapped - whole[0]).abs().max() > 0.01


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_photos_of_none_and_types_stay_what_they_are(dtype):
    photo = torch.rand(2, 3, 4, 5, dtype=dtype)
    for n in (2, 0):
        given, sigma = photo[:n].clone().requires_grad_(), SIGMAS[:n]
        for out in (chroma_blur(given, sigma, 11), sharpen(given, sigma, sigma, 11)):
            assert out.dtype == dtype and out.shape == given.shape
            (gradient,) = torch.autograd.grad(out.sum(), given)
            assert gradient.shape == given.shape and gradient.isfinite().all()


def test_gradients_of_every_argument():
    photo, amount = photos(3, 4).requires_grad_(), numbers(0.5, 2.0).requires_grad_()
    sigma = SIGMAS.clone().requires_grad_()
    check = functools.partial(torch.autograd.gradcheck, fast_mode=True)
    assert check(lambda p, s: chroma_blur(p, s, 5), (photo, sigma))
    assert check(lambda p, a, s: sharpen(p, a, s, 5), (photo, amount, sigma))
