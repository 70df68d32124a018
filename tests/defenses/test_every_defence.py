"""What every defence keeps, and the table of them."""

import pickle

import pytest
import torch

import moireaug
from moireaug import defenses
from moireaug.defenses import DEFENSES, Compose, Defended, Gain, Median, PixelDeflection, Quilting

BANK = torch.rand(300, 3, 5, 5, generator=torch.Generator().manual_seed(7))
RANDOMISED = {"pixel_deflection", "tvm", "randomised row"}
ALL = {
    **DEFENSES,
    "median_4": lambda: Median(4),
    "quilting": lambda: Quilting(BANK),
    "row": lambda: Compose((Gain(), Median(2))),
    "randomised row": lambda: Compose((Compose((PixelDeflection(50),)), Gain())),
    "no row": lambda: Compose(()),
}
KINDS = {"natural": torch.clone, "black": torch.zeros_like, "white": torch.ones_like}
SIZES = [(1, 1), (1, 7), (2, 1), (3, 3), (6, 5), (17, 33)]


def test_the_table_is_the_papers():
    assert len({build() for build in DEFENSES.values()}) == len(DEFENSES) == 11
    assert moireaug.defenses is defenses and set(defenses.__all__) <= set(dir(defenses))
    assert DEFENSES["tvm"]() == defenses.TotalVariation(0.5, 0.03, 100)
    assert DEFENSES["pixel_deflection"]() == PixelDeflection(200, 10, 0.04)


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("kind", KINDS)
def test_shape_type_range_input_and_gradient(name, kind, photos):
    defence, dtype = ALL[name](), torch.float64 if kind == "natural" else torch.float32
    for size in SIZES:
        images = KINDS[kind](photos(h=size[0], w=size[1])).to(dtype).requires_grad_()
        kept = images.detach().clone()
        out = defence(images)
        assert torch.equal(images, kept)
        assert out.shape == images.shape and out.dtype == dtype
        assert out.min() >= 0 and out.max() <= 1
        (gradient,) = torch.autograd.grad((out * torch.randn(out.shape, dtype=dtype)).sum(), images)
        assert gradient.isfinite().all() and (gradient.flatten(1).abs().amax(1) > 0).all(), size


@pytest.mark.parametrize("defence", [Gain(0.9), Compose((lambda x: 3 * x,))])
def test_what_is_clipped_keeps_its_gradient(defence, photos):
    """Or it would hide from an attack."""
    images = (0.5 + 0.5 * photos()).requires_grad_()
    out = defence(images)
    is_clipped = out.detach() == 1
    (gradient,) = torch.autograd.grad(out[is_clipped].sum(), images)
    assert is_clipped.any() and (gradient[is_clipped] != 0).all()


@pytest.mark.parametrize("name", ALL)
def test_half_precision_is_computed_in_float32(name, photos):
    defence, half = ALL[name](), photos(b=2, h=9, w=12).half()
    torch.manual_seed(5)
    out = defence(half)
    torch.manual_seed(5)
    with torch.autocast("cpu", torch.bfloat16):
        wanted = defence(half.float())
    assert out.dtype == torch.float16
    # a row hands half precision on between its defences
    assert torch.allclose(out.float(), wanted, atol=1e-3)
    assert "row" in name or torch.equal(out, wanted.half())
    empty = torch.rand(0, 3, 9, 20, requires_grad=True)
    assert torch.autograd.grad(defence(empty).sum(), empty)[0].shape == empty.shape


@pytest.mark.parametrize("name", ALL)
def test_replay_by_seed_by_image_and_from_a_pickle(name, photos):
    defence, images = ALL[name](), photos(h=24, w=24)
    again = pickle.loads(pickle.dumps(defence))
    assert (defence == again) == (name != "quilting") and isinstance(hash(defence), int)
    with pytest.raises(AttributeError):
        defence.quality = 3
    torch.manual_seed(3)
    first, state = defence(images), torch.get_rng_state()
    second = defence(images)
    torch.manual_seed(3)
    assert torch.equal(again(images), first)
    assert defence.randomised == (name in RANDOMISED)
    assert torch.equal(first, second) != defence.randomised
    torch.manual_seed(3)
    # one that is not takes no random numbers
    assert torch.equal(torch.get_rng_state(), state) != defence.randomised
    if not defence.randomised:
        assert torch.equal(torch.cat([defence(image[None]) for image in images]), first)


def test_bad_images_are_refused():
    for bad, error in [
        (torch.rand(3, 8, 8), ValueError),
        (torch.rand(1, 4, 8, 8), ValueError),
        (torch.rand(1, 3, 0, 8), ValueError),
        (torch.full((1, 3, 8, 8), 2.0), ValueError),
        (torch.full((1, 3, 8, 8), float("nan")), ValueError),
        (torch.zeros(1, 3, 8, 8, dtype=torch.uint8), TypeError),
        ([[0.5]], TypeError),
    ]:
        for defence in ALL.values():
            with pytest.raises(error, match="images must"):
                defence()(bad)


def test_bad_settings_are_refused():
    for build, error, says in (
        (lambda: defenses.JPEG(0), ValueError, "from 1 to 100; got 0"),
        (lambda: defenses.JPEG(60.5), TypeError, "whole number"),
        (lambda: defenses.BitDepth(9), ValueError, "from 1 to 8"),
        (lambda: Median(1), ValueError, "from 2 to 7"),
        (lambda: Gain(0), ValueError, "got 0"),
        (lambda: Gain("high"), TypeError, "got 'high'"),
        (lambda: PixelDeflection(-1), ValueError, "at least 0"),
        (lambda: PixelDeflection(window=0), ValueError, "at least 1"),
        (lambda: PixelDeflection(sigma=float("nan")), ValueError, "got nan"),
        (lambda: defenses.TotalVariation(keep=1.1), ValueError, "above 0, at most 1; got 1.1"),
        (lambda: defenses.TotalVariation(weight=0), ValueError, "got 0"),
        (lambda: defenses.TotalVariation(iterations=0), ValueError, "at least 1"),
        (lambda: Quilting([1]), TypeError, "from_images"),
        (lambda: Quilting(torch.rand(3, 3, 4, 4)), ValueError, r"\(N, 3, 5, 5\)"),
        (lambda: Quilting(torch.rand(0, 3, 5, 5)), ValueError, "N >= 1"),
        (lambda: Quilting(torch.rand(3, 3, 5, 5) - 1), ValueError, "finite"),
        (lambda: Quilting(torch.rand(3, 3, 5, 5), overlap=3), ValueError, "half of patch = 5"),
        (lambda: Compose(Gain()), TypeError, "one tuple"),
        (lambda: Compose((Gain,)), TypeError, "from images"),
        (lambda: Compose((Gain(), "jpeg")), TypeError, "'jpeg'"),
        (lambda: Defended(torch.nn.Flatten(), Gain(), draws=0), ValueError, "draws must be"),
        (lambda: Defended(3, Gain()), TypeError, "from images"),
        (lambda: defenses.restore_mean(BANK[:1], BANK[:1, :, 1:]), ValueError, "Give each image"),
    ):
        with pytest.raises(error, match=says):
            build()


@pytest.mark.parametrize("name", ["bits_4", "tvm", "quilting"])
def test_straight_through_is_the_identity_backward(name, photos):
    images, weight = photos(h=9, w=11).requires_grad_(), torch.randn(2, 3, 9, 11)
    (gradient,) = torch.autograd.grad((ALL[name]()(images) * weight).sum(), images)
    assert torch.equal(gradient, weight)


def test_a_defence_must_define_how_it_is_applied():
    with pytest.raises(TypeError, match="apply"):
        type("Half", (defenses.Defence,), {})()
