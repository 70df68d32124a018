"""Denoisers: OpenCV's own result, straight-through gradients, and images of any size."""

import cv2
import numpy as np
import pytest
import torch
import torch.nn.functional as F

from moireaug.camera.effects.denoise import DENOISERS, bilateral, nlm

SIZES = [(1, 1), (1, 7), (7, 1), (5, 6), (20, 23)]
DTYPES = [torch.float32, torch.float64]
FLAT = {"black": [0.0] * 3, "white": [1.0] * 3, "grey": [0.5] * 3, "colour": [0.9, 0.2, 0.4]}


def psnr(a, b):
    return -10 * (a - b).square().mean().log10()


def flat(name, size=(9, 9), dtype=torch.float32):
    return torch.tensor(FLAT[name], dtype=dtype)[:, None, None].expand(2, 3, *size).clone()


def opencv(photo, *, swapped=False):
    """cv2 on each uint8 image, without our code; `swapped` forgets that OpenCV's channels are B, G,
    R."""
    rows = []
    for codes in (photo * 255).round().to(torch.uint8).permute(0, 2, 3, 1).numpy():
        order = slice(None) if swapped else slice(None, None, -1)
        out = cv2.fastNlMeansDenoisingColored(np.ascontiguousarray(codes[..., order]))[..., order]
        rows.append(torch.from_numpy(out.copy()).permute(2, 0, 1))
    return torch.stack(rows).to(photo.dtype) / 255


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_nlm_is_opencvs(size):
    photo = torch.rand(2, 3, *size)
    for dtype in DTYPES:
        assert torch.equal(nlm(photo.to(dtype)), opencv(photo.to(dtype)))
    # negative control: OpenCV's channels are B, G, R
    assert size < (5, 6) or not torch.equal(nlm(photo), opencv(photo, swapped=True))


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("name", DENOISERS)
def test_any_size_stays_what_it_is(name, size):
    for dtype in DTYPES:
        photo = torch.rand(2, 3, *size, dtype=dtype)
        kept = photo.clone()
        out = DENOISERS[name](photo)
        assert torch.equal(photo, kept)
        assert out.shape == photo.shape and out.dtype == dtype and out.is_contiguous()
        assert out.min() >= 0 and out.max() <= 1
        assert DENOISERS[name](photo[:0]).shape == (0, 3, *size)


@pytest.mark.parametrize("name", DENOISERS)
def test_noise_goes_and_edges_stay(name):
    clean = F.interpolate(torch.rand(2, 3, 4, 4), size=(40, 40))
    noisy = (clean + 4 / 255 * torch.randn(clean.shape)).clamp(0, 1)
    out = DENOISERS[name](noisy)
    assert psnr(out, clean) > psnr(noisy, clean) + 2
    # a plain blur is no denoiser
    assert psnr(out, clean) > psnr(F.avg_pool2d(noisy, 5, 1, 2), clean) + 5
    others = [DENOISERS[name](row[None])[0] for row in noisy]
    torch.testing.assert_close(out, torch.stack(others))  # each photo on its own


@pytest.mark.parametrize("colour", FLAT)
@pytest.mark.parametrize(("name", "codes"), [("nlm", 4), ("bilateral", 1e-4)])
def test_flat_stays_flat(name, codes, colour):
    photo = flat(colour)
    out = DENOISERS[name](photo)
    assert (out - out[:, :, :1, :1]).abs().max() < 1e-6
    assert (out - photo).abs().max() * 255 < codes + 0.6  # and 8-bit codes are half a code off


def test_nlm_does_not_depend_on_threads():
    photo, threads = torch.rand(1, 3, 50, 60), cv2.getNumThreads()
    first = nlm(photo)
    try:
        for n in (1, 3):
            cv2.setNumThreads(n)
            assert torch.equal(nlm(photo), first)
    finally:
        cv2.setNumThreads(threads)


def test_nlm_passes_the_gradient_straight_through():
    photo = torch.rand(2, 3, 9, 11, dtype=torch.float64, requires_grad=True)
    weight = torch.randn(photo.shape, dtype=torch.float64)
    assert torch.equal(torch.autograd.grad((nlm(photo) * weight).sum(), photo)[0], weight)
    assert not nlm(photo.detach()).requires_grad


def test_bilateral_gradcheck():
    photo = torch.rand(1, 3, 3, 4, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(bilateral, photo, fast_mode=True)


@pytest.mark.parametrize("colour", FLAT)
@pytest.mark.parametrize("name", DENOISERS)
def test_gradients_of_flat_photos_are_finite(name, colour):
    for size in ((1, 1), (1, 7), (9, 9)):
        photo = flat(colour, size).requires_grad_()
        weighted = DENOISERS[name](photo) * torch.rand(photo.shape)
        (gradient,) = torch.autograd.grad(weighted.sum(), photo)
        assert gradient.isfinite().all() and (gradient > 0).all()


def test_nlm_refuses_nan():
    with pytest.raises(ValueError, match="holds NaN"):
        nlm(torch.full((1, 3, 4, 4), torch.nan))


def test_nlm_is_a_sound_operator():
    checks = ("test_schema", "test_autograd_registration", "test_faketensor")
    photo = torch.rand(2, 3, 9, 11, requires_grad=True)
    found = torch.library.opcheck(torch.ops.moireaug.nlm.default, (photo,), test_utils=checks)
    assert found == dict.fromkeys(checks, "SUCCESS")
