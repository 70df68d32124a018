"""JPEG, bit depth, median and brightness: against the libraries they stand for and by hand."""

import io

import numpy as np
import pytest
import torch
from PIL import Image
from scipy.ndimage import median_filter

from moireaug.camera.effects.jpeg import jpeg
from moireaug.defenses import JPEG, BitDepth, Gain, Median, restore_mean

DTYPES = [torch.float32, torch.float64]


@pytest.mark.parametrize("quality", [1, 60, 100])
def test_jpeg_is_pils(photos, quality):
    images = photos(h=25, w=38)
    for out, image in zip(JPEG(quality)(images), images, strict=True):
        file = io.BytesIO()
        codes = (image * 255).round().to(torch.uint8).permute(1, 2, 0).numpy()
        Image.fromarray(codes).save(file, "JPEG", quality=quality)
        found = (out * 255).round().permute(1, 2, 0).numpy()
        assert np.array_equal(found, np.asarray(Image.open(file)))


def test_jpegs_gradient_is_that_of_the_cameras(photos):
    images = photos().requires_grad_()
    weight = torch.randn(images.shape)
    wanted = torch.autograd.grad((jpeg(images, torch.full((2,), 40.0)) * weight).sum(), images)[0]
    assert torch.equal(torch.autograd.grad((JPEG(40)(images) * weight).sum(), images)[0], wanted)


@pytest.mark.parametrize("dtype", DTYPES, ids=str)
def test_bit_depth_is_numpys_formula_with_halves_to_even(dtype):
    for bits in (1, 4, 5, 8):
        top = 2**bits - 1
        halves = (torch.arange(top, dtype=dtype) + 0.5) / top
        values = torch.cat([halves, torch.linspace(0, 1, 300, dtype=dtype)])
        images = values[: len(values) // 3 * 3].view(1, 3, 1, -1)
        out = BitDepth(bits)(images)
        assert np.array_equal(out.numpy(), np.rint(images.numpy() * top) / top)
        assert len(out.unique()) == 2**bits
        assert torch.equal(BitDepth(bits)(out), out)


@pytest.mark.parametrize("dtype", DTYPES, ids=str)
@pytest.mark.parametrize("size", [2, 3, 4, 5, 6, 7])
def test_median_is_scipys(photos, size, dtype):
    for shape in [(1, 1), (1, 5), (2, 3), (16, 21)]:
        for images in (
            photos(h=shape[0], w=shape[1], dtype=dtype),
            torch.rand(2, 3, *shape, dtype=dtype),
        ):
            wanted = median_filter(images.numpy(), (1, 1, size, size), mode="reflect")
            assert np.array_equal(Median(size)(images).numpy(), wanted)


def test_medians_gradient_is_exact_where_values_differ():
    # steps of gradcheck are smaller than any two values' difference, so the order stays
    images = (torch.randperm(3 * 5 * 4).double() / 60).view(1, 3, 5, 4).requires_grad_()
    for size in (2, 3, 4):
        assert torch.autograd.gradcheck(Median(size), (images * 0.9 + 0.05,), eps=1e-5)


def test_medians_gradient_goes_to_the_first_of_equals():
    images = torch.full((1, 3, 4, 4), 0.5, requires_grad=True)
    (gradient,) = torch.autograd.grad(Median(3)(images)[0, 0, 2, 2], images)
    assert gradient.sum() == gradient[0, 0, 1, 1] == 1


def test_gain_brings_every_image_to_the_mean(photos):
    images = photos(b=4) * torch.tensor([0.3, 0.5, 0.7, 0.9])[:, None, None, None]
    out = Gain(0.3)(images)
    assert torch.allclose(out.mean((1, 2, 3)), torch.full((4,), 0.3), atol=1e-6)
    assert torch.allclose(out, images * (0.3 / images.mean((1, 2, 3), keepdim=True)))
    clipped = Gain(0.9)(images)
    assert clipped.max() == 1 and (clipped.mean((1, 2, 3)) < 0.9).any()


def test_gain_on_black_and_nearly_black_and_its_gradient(photos):
    black, nearly = torch.zeros(1, 3, 4, 4), torch.full((1, 3, 4, 4), 1e-4)
    assert torch.equal(Gain()(black), black)
    assert torch.allclose(Gain(0.4)(nearly), nearly * 0.4 * 255)
    images = (photos(b=1, h=4, w=5, dtype=torch.float64) * 0.4 + 0.1).requires_grad_()
    assert torch.autograd.gradcheck(Gain(0.4), images)


def test_mean_normalisation_brings_back_the_clean_mean(photos):
    for dtype, atol in ((torch.float64, 1e-6), (torch.float32, 1e-6), (torch.float16, 1e-3)):
        clean = (photos(b=3, dtype=torch.float64) * 0.5 + 0.25).to(dtype)
        shifted = clean + torch.tensor([-0.2, 0.0, 0.2], dtype=dtype)[:, None, None, None]
        assert torch.allclose(restore_mean(shifted, clean), clean, atol=atol)
        out = restore_mean(torch.rand(3, 3, 32, 40).to(dtype), clean)
        assert out.dtype == dtype and out.min() >= 0 and out.max() <= 1


def test_mean_normalisation_clips_and_has_gradients_in_both(photos):
    dark, bright = photos(b=1) * 0.5, photos(b=1) * 0.5 + 0.5
    out = restore_mean(dark, bright)
    assert torch.equal(out, (dark - (dark.mean() - bright.mean())).clamp(0, 1))
    images, clean = (
        x.double().mul(0.5).add(0.2)[..., :3, :4].requires_grad_() for x in (dark, bright)
    )
    assert torch.autograd.gradcheck(restore_mean, (images, clean))
    with pytest.raises(ValueError, match="images must"):
        restore_mean(dark, bright + 1)
