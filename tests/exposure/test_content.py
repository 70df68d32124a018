"""Which panel pixels a sensor pixel sees: shares in closed form against the integral that they
stand for."""

import math

import pytest
import torch

from moireaug.exposure import content
from moireaug.exposure.content import Footprint
from moireaug.exposure.optics import Optics

CASES = [  # box, standard deviation, width of the subpixel; all in cells
    (1.0, 0.1, 1.0),
    (0.7, 0.25, 1 / 3),
    (2.3, 0.4, 2 / 3),
    (0.05, 0.3, 0.5),
    (1.4, 1e-6, 0.25),
    (1e-3, 1e-3, 1 / 3),
]
OFFSETS = torch.linspace(-0.5, 0.5, 11, dtype=torch.float64)[None, None]


def fields(box, sigma, width):
    full = [torch.full_like(OFFSETS, v) for v in (box, sigma**2, width)]
    return Footprint(*full[:2]), full[2]


def shares(*given):
    """The shares of all taps, stacked along a last axis."""
    return torch.stack(content.shares(*given), -1)


def normalised(share):
    """The same for shares that are stacked."""
    return torch.stack(content.normalised(list(share.unbind(-1))), -1)


@pytest.mark.parametrize(("box", "sigma", "width"), CASES)
def test_shares_of_all_subpixels_are_the_masks_mean(box, sigma, width):
    seen, wide = fields(box, sigma, width)
    share = shares(OFFSETS, seen, wide, 21)
    assert share.shape == (1, 1, 11, 21)
    # of a mask whose subpixels repeat in every cell, over an aperture that may be narrower than one
    whole = share.sum(-1)
    assert whole.mean().item() == pytest.approx(width, rel=0.2)
    narrow = torch.full_like(OFFSETS, 1.0)  # a mask without gaps is seen whole from everywhere
    assert torch.allclose(
        shares(OFFSETS, seen, narrow, 21).sum(-1), torch.ones(()).double(), atol=1e-9
    )


@pytest.mark.parametrize(("box", "sigma", "width"), CASES)
def test_shares_are_the_integral_of_box_gaussian_and_subpixel(box, sigma, width):
    seen, wide = fields(box, sigma, width)
    found = shares(OFFSETS, seen, wide, 5)
    steps = 40000
    # the box summed at its mid points, the subpixel under the Gaussian in closed form
    u = (torch.arange(steps, dtype=torch.float64) + 0.5) / steps * box - box / 2
    for i, offset in enumerate(OFFSETS.flatten().tolist()):
        for j, k in enumerate(range(-2, 3)):
            at = offset - k + u
            inside = torch.special.ndtr((at + width / 2) / sigma) - torch.special.ndtr(
                (at - width / 2) / sigma
            )
            assert found[0, 0, i, j].item() == pytest.approx(inside.mean().item(), abs=5e-5)


def test_a_wrong_width_is_noticed():
    seen, wide = fields(0.7, 0.25, 1 / 3)
    assert (
        shares(OFFSETS, seen, wide, 5) - shares(OFFSETS, seen, 1.01 * wide, 5)
    ).abs().max() > 1e-3


def test_gradients_of_every_argument():
    offset = torch.tensor([[[-0.4, 0.0, 0.13, 0.5]]], dtype=torch.float64, requires_grad=True)
    box, variance, width = (torch.full_like(offset, v).requires_grad_() for v in (0.8, 0.04, 0.3))
    assert torch.autograd.gradcheck(
        lambda o, b, v, w: shares(o, Footprint(b, v), w, 3), (offset, box, variance, width)
    )
    assert torch.autograd.gradcheck(
        lambda o, b, v, w: normalised(shares(o, Footprint(b, v), w, 3)),
        (offset, box, variance, width),
    )


def test_normalised_shares_sum_to_one_where_nothing_is_seen_too():
    share = torch.tensor(
        [[[[0.2, 0.3, 0.1], [0.0, 0.0, 0.0], [-1e-18, 0.0, 0.4]]]], dtype=torch.float64
    )
    whole = normalised(share.requires_grad_())
    assert torch.allclose(whole.sum(-1), torch.ones(()).double())
    assert whole[0, 0, 1].tolist() == [0, 1, 0] and whole[0, 0, 2, 2] > 0.999
    (gradient,) = torch.autograd.grad(whole[..., 0].sum(), share)
    assert gradient.isfinite().all()


STEPS = torch.tensor(
    [[1.2, 0.0], [0.9, -0.5], [-0.3, 0.3], [0.0, 0.0], [1e-9, 2.0]], dtype=torch.float64
)[None]


def test_a_footprint_has_the_variance_of_what_blurs():
    optics = Optics(*(torch.tensor([v], dtype=torch.float64) for v in (0.9, 0.3, 0.5)))
    seen = content.footprint(STEPS, optics)
    wanted = STEPS.square().sum(-1) * optics.variance()
    assert torch.allclose(seen.box.square() / 12 + seen.variance, wanted, atol=1e-11)
    assert torch.allclose(seen.box, 0.9 * STEPS.abs().amax(-1))


@pytest.mark.parametrize("taps", [1, 3, 7])
def test_what_is_fitted_reaches_no_further_and_loses_no_variance(taps):
    width = torch.full((1, 3), 0.4, dtype=torch.float64)
    box = torch.tensor([[0.1, 2.0, 30.0]], dtype=torch.float64)
    seen = Footprint(box, torch.tensor([[1e-4, 0.3, 9.0]], dtype=torch.float64))
    kept, lost = content.fitted(seen, width, taps)
    assert (kept.reach() + width / 2 <= taps / 2 + 1e-12).all()
    assert torch.allclose(
        kept.box.square() / 12 + kept.variance + lost, seen.box.square() / 12 + seen.variance
    )
    assert ((lost == 0) == (seen.reach() + width / 2 <= taps / 2)).all()
    assert lost[0, 0] == 0 and lost[0, 2] > 0


@pytest.mark.parametrize("fill", [0.5, 1.0])
def test_the_transfer_is_that_of_the_spread(fill):
    """Optics in space, as mid-quantiles of the light, and in frequency are one thing."""
    optics = Optics(*(torch.tensor([v], dtype=torch.float64) for v in (fill, 0.25, 0.4)))
    points = optics.quantiles(4000)[0]
    assert points.square().mean().item() == pytest.approx(optics.variance().item(), rel=1e-3)
    for f in (0.1, 0.5, 1.3):
        at = torch.tensor([f], dtype=torch.float64)
        passed = torch.cos(2 * math.pi * f * points).mean()
        assert optics.transfer(at, 0 * at).item() == pytest.approx(passed.item(), abs=1e-4)
