"""JPEG: the decoder's own result forward, a gradient that an attack can follow backward."""

import cv2
import numpy as np
import pytest
import torch
import torch.nn.functional as F
from kornia.enhance import jpeg_codec_differentiable

from moireaug.camera.effects.jpeg import STRAIGHT_THROUGH_SHARE, jpeg

SIZES = [(1, 1), (1, 7), (7, 1), (8, 8), (17, 33), (48, 40)]
DTYPES = [torch.float32, torch.float64]
QUALITIES = [1.0, 20.0, 75.0, 100.0]


def scenes(b=2, n=48, dtype=torch.float32):
    """Photos of blobs of colour with some noise."""
    blobs = F.interpolate(torch.rand(b, 3, n // 8, n // 8), size=(n, n), mode="bicubic")
    return (blobs + 0.03 * torch.randn(blobs.shape)).clamp(0, 1).to(dtype)


def opencv(photo, qualities, *, swapped=False):
    """Another library's libjpeg; `swapped` forgets that OpenCV's channels are B, G, R on the way
    in."""
    photos = (photo * 255).round().to(torch.uint8).permute(0, 2, 3, 1).numpy()
    rows = []
    for codes, q in zip(photos, qualities, strict=True):
        bgr = np.ascontiguousarray(codes if swapped else codes[..., ::-1])
        file = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, int(q)])[1]
        rows.append(cv2.imdecode(file, cv2.IMREAD_COLOR)[..., ::-1])
    return torch.from_numpy(np.stack(rows)).permute(0, 3, 1, 2).to(photo.dtype) / 255


@pytest.mark.parametrize("dtype", DTYPES, ids=str)
@pytest.mark.parametrize("size", SIZES, ids=str)
def test_forward_is_libjpegs(size, dtype):
    photo = torch.rand(4, 3, *size, dtype=dtype)
    kept = photo.clone()
    out = jpeg(photo, torch.tensor(QUALITIES))
    assert torch.equal(photo, kept)
    assert out.shape == photo.shape and out.dtype == dtype and out.is_contiguous()
    assert out.min() >= 0 and out.max() <= 1
    off = (out - opencv(photo, QUALITIES)).abs() * 255
    assert off.max() < 2.5 and off.mean() < 0.1  # builds of libjpeg may round differently
    # negative control
    assert size != (48, 40) or (out - opencv(photo, QUALITIES, swapped=True)).abs().max() > 0.1


def test_no_photos_at_all():
    photo = torch.rand(0, 3, 9, 20, requires_grad=True)
    out = jpeg(photo, torch.zeros(0))
    assert out.shape == torch.autograd.grad(out.sum(), photo)[0].shape == photo.shape


def test_quality_is_rounded_and_clamped():
    given, used = torch.tensor(
        [[-3.0, 1.0], [0.0, 1.0], [74.6, 75.0], [75.4, 75.0], [1e9, 100.0]]
    ).T
    photo = scenes(1).expand(5, -1, -1, -1)
    assert torch.equal(jpeg(photo, given), jpeg(photo, used))
    assert torch.equal(jpeg(photo, given.long()), jpeg(photo, given.long().float()))


def test_the_gradient_is_kornias_with_a_share_straight_through(monkeypatch):
    photo = scenes(3, dtype=torch.float64)[..., :37, :21].requires_grad_()
    quality = torch.tensor([10.0, 60.0, 95.0])
    weight = torch.randn(photo.shape, dtype=torch.float64)
    (want,) = torch.autograd.grad((jpeg_codec_differentiable(photo, quality) * weight).sum(), photo)
    out = jpeg(photo, quality.requires_grad_())
    got, none = torch.autograd.grad((out * weight).sum(), (photo, quality), allow_unused=True)
    torch.testing.assert_close(got, want + STRAIGHT_THROUGH_SHARE * weight)
    assert none is None

    monkeypatch.setattr("kornia.enhance.jpeg_codec_differentiable", None)
    assert torch.equal(jpeg(photo, quality), out)  # forward never calls it


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (9, 20)], ids=str)
@pytest.mark.parametrize("colour", [[0.0] * 3, [1.0] * 3, [0.5] * 3, [0.9, 0.2, 0.4]], ids=str)
def test_gradients_of_flat_photos_are_finite(colour, size):
    photo = torch.tensor(colour)[:, None, None].expand(34, 3, *size).clone().requires_grad_()
    out = jpeg(photo, torch.arange(1.0, 101.0, 3.0))
    (gradient,) = torch.autograd.grad((out * (torch.rand(out.shape) + 0.5)).sum(), photo)
    assert gradient.isfinite().all()
    if colour in ([0.0] * 3, [1.0] * 3):  # which do not hide from an attack
        assert (gradient != 0).all()


@pytest.mark.parametrize("quality", [10.0, 50.0, 90.0])
def test_signed_gradient_steps_beat_random_signs(quality):
    photo, eps = scenes(2, 32), 8 / 255
    quality = torch.full((2,), quality)
    weight = F.avg_pool2d(torch.randn(photo.shape), 5, 1, 2)
    weight = weight / weight.abs().mean()

    def loss(x):
        return (jpeg(x, quality) * weight).mean()

    def reached(sign):
        x = photo
        for _ in range(5):
            x = (x - eps / 3 * sign(x)).clamp(photo - eps, photo + eps).clamp(0, 1)
        return loss(x)

    def gradient(x):
        x = x.detach().requires_grad_()
        return torch.autograd.grad(loss(x), x)[0].sign()

    start = loss(photo)
    # no step within eps can take more than eps off this loss by an identity; chance takes next to
    # nothing
    assert start - reached(gradient) > 0.5 * eps
    assert start - reached(lambda x: torch.randn(x.shape).sign()) < 0.1 * eps


@pytest.mark.parametrize(
    ("photo", "quality", "sentence"),
    [
        (torch.full((1, 3, 4, 4), torch.nan), torch.tensor([50.0]), "holds NaN"),
        (torch.zeros(1, 3, 4, 4), torch.tensor([torch.nan]), "NaN"),
        (torch.zeros(2, 3, 4, 4), torch.tensor([50.0]), "shorter"),
    ],
    ids=["photo", "quality", "count"],
)
def test_what_is_refused(photo, quality, sentence):
    with pytest.raises(ValueError, match=sentence):
        jpeg(photo, quality)


def test_is_a_sound_operator():
    checks = ("test_schema", "test_autograd_registration", "test_faketensor")
    args = (torch.rand(2, 3, 9, 11, requires_grad=True), torch.tensor([30.0, 80.0]))
    found = torch.library.opcheck(torch.ops.moireaug.jpeg.default, args, test_utils=checks)
    assert found == dict.fromkeys(checks, "SUCCESS")


def test_the_gradient_has_a_gradient():
    photo = scenes(b=1, n=16, dtype=torch.float64).requires_grad_()
    weight, way = torch.randn(2, 1, 3, 16, 16, dtype=torch.float64)

    def squared(weight):
        out = jpeg(photo, torch.tensor([60.0]))
        (grad,) = torch.autograd.grad((out * weight).sum(), photo, create_graph=True)
        return grad.square().sum()

    weight.requires_grad_()
    (slope,) = torch.autograd.grad(squared(weight), weight)
    step = 1e-4 * way
    expected = (squared(weight + step) - squared(weight - step)) / 2e-4
    assert (slope * way).sum().item() == pytest.approx(expected.item(), rel=1e-6)


def test_the_gradient_is_computed_in_full_precision_within_autocast():
    photo, quality = scenes().requires_grad_(), torch.tensor([60.0, 90.0])
    weight = torch.randn(photo.shape)
    gradients = []
    for half in (False, True):
        loss = (jpeg(photo, quality) * weight).sum()
        with torch.autocast("cpu", torch.bfloat16, enabled=half):
            gradients += torch.autograd.grad(loss, photo)
    assert torch.equal(*gradients)
