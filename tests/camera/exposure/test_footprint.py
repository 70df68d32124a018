"""Which panel pixels a sensor pixel sees: shares in closed form against the integral that they
stand for."""

import math

import pytest
import torch

from moireaug.camera.exposure import footprint
from moireaug.camera.exposure.footprint import Footprint, Optics

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
    """The shares of all taps, along a last axis."""
    return footprint.tap_weights(*given).movedim(0, -1)


def normalised(share):
    """The same for shares along a last axis."""
    return footprint.normalised(share.movedim(-1, 0)).movedim(0, -1)


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
            past, before = (torch.special.ndtr((at + w / 2) / sigma) for w in (width, -width))
            inside = (past - before).mean().item()
            assert found[0, 0, i, j].item() == pytest.approx(inside, abs=5e-5)
    if box == 0.7:  # negative control: a wrong width
        assert (found - shares(OFFSETS, seen, 1.01 * wide, 5)).abs().max() > 1e-3


def test_gradients_of_every_argument():
    offset = torch.tensor([[[-0.4, 0.0, 0.13, 0.5]]], dtype=torch.float64, requires_grad=True)
    box, variance, width = (torch.full_like(offset, v).requires_grad_() for v in (0.8, 0.04, 0.3))

    def three(offset, box, variance, width):
        return shares(offset, Footprint(box, variance), width, 3)

    given = (offset, box, variance, width)
    assert torch.autograd.gradcheck(three, given)
    assert torch.autograd.gradcheck(lambda *values: normalised(three(*values)), given)


def test_normalised_shares_sum_to_one_where_nothing_is_seen_too():
    rows = [[0.2, 0.3, 0.1], [0.0, 0.0, 0.0], [-1e-18, 0.0, 0.4]]
    share = torch.tensor([[rows]], dtype=torch.float64)
    whole = normalised(share.requires_grad_())
    assert torch.allclose(whole.sum(-1), torch.ones(()).double())
    assert whole[0, 0, 1].tolist() == [0, 1, 0] and whole[0, 0, 2, 2] > 0.999
    (gradient,) = torch.autograd.grad(whole[..., 0].sum(), share)
    assert gradient.isfinite().all()


STEPS = torch.tensor(
    [[1.2, 0.0], [0.9, -0.5], [-0.3, 0.3], [0.0, 0.0], [1e-9, 2.0]], dtype=torch.float64
)[None]


def optics(fill, blur, olpf, motion_x=0.0, motion_y=0.0):
    given = (fill, blur, olpf, motion_x, motion_y)
    return Optics(*(torch.tensor([v], dtype=torch.float64) for v in given))


def test_a_footprint_has_the_variance_of_what_blurs():
    seen = Footprint.of(STEPS, optics(0.9, 0.3, 0.5))
    # of a box, a Gaussian, and two points
    wanted = STEPS.square().sum(-1) * (0.9**2 / 12 + 0.3**2 + 0.5**2 / 4)
    assert torch.allclose(seen.box.square() / 12 + seen.variance, wanted, atol=1e-11)
    assert torch.allclose(seen.box, 0.9 * STEPS.abs().amax(-1))


@pytest.mark.parametrize("motion", [(0.8, 0.0), (0.0, 0.8), (0.5, -0.7)])
def test_motion_widens_a_footprint_by_how_far_it_goes_along_the_axis(motion):
    still, moved = optics(0.9, 0.3, 0.5), optics(0.9, 0.3, 0.5, *motion)
    seen, sharp = Footprint.of(STEPS, moved), Footprint.of(STEPS, still)
    along = STEPS @ torch.tensor(motion, dtype=torch.float64)
    assert torch.equal(seen.box, sharp.box)
    assert torch.allclose(seen.variance - sharp.variance, along.square(), atol=1e-12)
    assert (along.square() - 0.64 * STEPS.square().sum(-1)).abs().max() > 0.1  # not a round spread


@pytest.mark.parametrize("taps", [1, 3, 7])
def test_what_is_fitted_reaches_no_further_and_loses_no_variance(taps):
    width = torch.full((1, 3), 0.4, dtype=torch.float64)
    box = torch.tensor([[0.1, 2.0, 30.0]], dtype=torch.float64)
    seen = Footprint(box, torch.tensor([[1e-4, 0.3, 9.0]], dtype=torch.float64))
    kept, lost = seen.fitted(width, taps)
    assert (kept.reach() + width / 2 <= taps / 2 + 1e-12).all()
    assert torch.allclose(
        kept.box.square() / 12 + kept.variance + lost, seen.box.square() / 12 + seen.variance
    )
    assert ((lost == 0) == (seen.reach() + width / 2 <= taps / 2)).all()
    assert lost[0, 0] == 0 and lost[0, 2] > 0


@pytest.mark.parametrize("fill", [0.5, 1.0])
def test_the_transfer_is_that_of_the_spread(fill):
    """Optics in space, as mid-quantiles of the light, and in frequency are one thing."""
    blurring = optics(fill, 0.25, 0.4)
    points = blurring.quantiles(4000)[0]
    variance = fill**2 / 12 + 0.25**2 + 0.4**2 / 4
    assert points.square().mean().item() == pytest.approx(variance, rel=1e-3)
    for f in (0.1, 0.5, 1.3):
        at = torch.tensor([f], dtype=torch.float64)
        passed = torch.cos(2 * math.pi * f * points).mean()
        assert blurring.transfer(at, 0 * at).item() == pytest.approx(passed.item(), abs=1e-4)


MOTIONS = [(0.0, 0.0), (0.7, 0.0), (0.0, -0.7), (0.4, 0.3), (0.4, -0.3)]
FREQUENCIES = [(0.3, 0.0), (0.0, 0.3), (0.2, 0.2), (0.2, -0.2), (0.6, -0.1)]


def off_brute_force(motion, mirrored=1):
    """How far the transfer is from the mean of a wave over the points that stand for the spread,
    at most."""
    blurring = optics(0.9, 0.25, 0.4, *motion)
    down, across = blurring.offsets(48)[0]
    most = 0.0
    for fu, fv in FREQUENCIES:
        passed = torch.cos(2 * math.pi * (fu * across + mirrored * fv * down)).mean()
        u, v = (torch.tensor([f], dtype=torch.float64) for f in (fu, fv))
        most = max(most, abs(blurring.transfer(u, v).item() - passed.item()))
    return most


def test_the_transfer_is_the_mean_over_the_points_of_brute_force():
    for motion in MOTIONS:
        assert off_brute_force(motion) < 0.01, motion
    # negative control: motion along the other diagonal
    assert off_brute_force((0.4, 0.3), mirrored=-1) > 0.1


@pytest.mark.parametrize("n", [1, 2, 8])
def test_points_have_the_motions_variance_in_any_number(n):
    """Nearly, but a single one, which stands for the middle of the spread."""
    still, moved = optics(0.9, 0.3, 0.5).offsets(n), optics(0.9, 0.3, 0.5, 0.6, -0.2).offsets(n)
    assert still.shape == moved.shape == (1, 2, n**2)
    added = (moved[0] @ moved[0].T - still[0] @ still[0].T) / n**2
    wanted = torch.tensor([[0.04, -0.12], [-0.12, 0.36]], dtype=torch.float64)
    assert torch.allclose(added, wanted * (n > 1), atol=0.45 / n if n > 1 else 1e-12)
