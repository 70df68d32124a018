"""Pixel deflection: where colours come from, how many move, and that wavelets smooth."""

import numpy as np
import pytest
import torch
from skimage.restoration import denoise_wavelet

from moireaug.defenses import PixelDeflection
from moireaug.defenses.deflection import denoise


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_denoising_is_scikit_images(photos, dtype):
    images = photos(h=33, w=48, dtype=dtype)
    for out, image in zip(denoise(images, 0.04), images, strict=True):
        channels_last = image.permute(1, 2, 0).numpy()
        settings = {"method": "BayesShrink", "mode": "soft", "convert2ycbcr": True}
        wanted = denoise_wavelet(channels_last, sigma=0.04, channel_axis=-1, **settings)
        assert np.allclose(out.permute(1, 2, 0).numpy(), wanted.clip(0, 1), atol=1e-6)


def test_flat_images_stay_flat():
    images = torch.tensor([0.0, 0.4, 1.0]).view(3, 1, 1, 1).expand(3, 3, 20, 31)
    assert torch.allclose(PixelDeflection()(images), images, atol=1e-3)


def test_no_deflections_leave_only_the_denoising(photos):
    images = photos()
    assert torch.equal(PixelDeflection(0)(images), denoise(images, 0.04))


@pytest.mark.parametrize(("h", "w"), [(1, 1), (1, 9), (30, 25), (64, 64)])
def test_colours_come_from_the_window_and_the_image(h, w):
    defence = PixelDeflection(deflections=1, window=4)
    offsets = []
    for source in defence.sources(400, h, w):
        at = np.flatnonzero(source != np.arange(h * w))
        assert len(at) <= 1  # a pixel can draw itself
        for to in at:
            offsets.append(np.subtract(divmod(source[to], w), divmod(to, w)))
    if h * w > 1:
        offsets = np.array(offsets)
        assert np.abs(offsets).max() == 4 and (offsets[:, 1].min(), offsets[:, 1].max()) == (-4, 4)


def test_places_and_offsets_are_uniform():
    source = PixelDeflection(deflections=1, window=1).sources(9000, 3, 3)
    image, at = np.nonzero(source != np.arange(9))
    # the middle draws itself once in nine times, an edge once in six, a corner once in four
    wanted = 1000 * np.array([3 / 4, 5 / 6, 3 / 4, 5 / 6, 8 / 9, 5 / 6, 3 / 4, 5 / 6, 3 / 4])
    assert np.abs(np.bincount(at, minlength=9) - wanted).max() < 5 * np.sqrt(1000)
    middle = np.bincount(source[image[at == 4], 4], minlength=9)
    assert middle[4] == 0
    assert np.abs(np.delete(middle, 4) - middle.sum() / 8).max() < 5 * np.sqrt(middle.sum() / 8)


def test_deflections_follow_each_other(monkeypatch):
    # pixel 1 takes 0's colour, then 2 takes 1's, which is 0's by now
    u = torch.tensor([[[0.0, 0.0], [0.4, 0.7], [0.0, 0.0], [0.0, 0.0]]], dtype=torch.float64)
    monkeypatch.setattr(torch, "rand", lambda *a, **k: u)
    assert PixelDeflection(2, window=1).sources(1, 1, 3).tolist() == [[0, 0, 0]]


def test_the_count_and_the_channels(photos):
    images = photos(b=1, h=64, w=64)
    torch.manual_seed(0)
    source = PixelDeflection(200).sources(1, 64, 64)[0]
    assert 180 < (source != np.arange(64 * 64)).sum() <= 200
    torch.manual_seed(0)
    # all channels by the same map
    moved = images.flatten(2)[..., torch.from_numpy(source)].view_as(images)
    assert torch.equal(PixelDeflection(200)(images), denoise(moved, 0.04))


def test_the_gradient_goes_where_the_colour_came_from(photos):
    images = photos(b=2, h=12, w=10).requires_grad_()
    weight = torch.randn(images.shape)
    torch.manual_seed(4)
    (gradient,) = torch.autograd.grad((PixelDeflection(30)(images) * weight).sum(), images)
    torch.manual_seed(4)
    wanted = torch.zeros(2, 3, 120)
    for i, source in enumerate(PixelDeflection(30).sources(2, 12, 10)):
        wanted[i].index_add_(1, torch.from_numpy(source), weight[i].flatten(1))
    assert torch.allclose(gradient.flatten(2), wanted, atol=1e-6)
    assert not torch.allclose(gradient, weight)
