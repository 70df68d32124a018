"""Total variation minimisation: against another solver, a long run, and what must not change."""

import pytest
import torch
import torch.nn.functional as F
from skimage.restoration import denoise_tv_chambolle

from moireaug.defenses import TotalVariation, variation
from moireaug.defenses.variation import fill, minimise

WEIGHT = 0.03


def masked(x, keep=0.5, seed=1):
    return (torch.rand(x.shape, generator=torch.Generator().manual_seed(seed)) < keep).to(x)


def objective(z, x, mask, weight):
    """What `TotalVariation` minimises, (B, C), of z, x and mask (B, C, H, W)."""
    down, right = F.pad(z.diff(dim=2), (0, 0, 0, 1)), F.pad(z.diff(dim=3), (0, 1))
    variation = (down.square() + right.square()).sqrt()
    return (mask * (z - x).square() / 2 + weight * variation).sum((2, 3))


def test_the_objective_by_hand():
    z = torch.tensor([[[[0.0, 0.3], [0.4, 0.0]]]])
    x, mask = torch.ones_like(z), torch.tensor([[[[1.0, 0.0], [0.0, 1.0]]]])
    # lengths of (down, right): (0.4, 0.3), (-0.3, 0), (0, -0.4), (0, 0)
    assert objective(z, x, mask, 2.0).item() == pytest.approx(1.0 + 2 * (0.5 + 0.3 + 0.4))


@pytest.mark.parametrize(
    ("h", "w", "keep"), [(18, 23, 0.5), (18, 23, 1.0), (1, 30, 0.5), (2, 2, 1.0)]
)
def test_the_objective_falls_to_that_of_a_long_run(photos, h, w, keep):
    x = photos(h=h, w=w, dtype=torch.float64)
    mask = masked(x, keep)
    best = minimise(x, mask, WEIGHT, 600)
    least = objective(best, x, mask, WEIGHT)
    first, last = (objective(minimise(x, mask, WEIGHT, n), x, mask, WEIGHT) for n in (1, 100))
    assert (last >= least * (1 - 1e-4)).all() and (first >= least * (1 - 1e-4)).all()
    assert (last <= least * 1.01 + 1e-9).all() and (last <= first + 1e-9).all()
    assert (minimise(x, mask, WEIGHT, 100) - best).abs().mean() < 1 / 255
    single = minimise(x.float(), mask.float(), WEIGHT, 100)
    assert (objective(single.double(), x, mask, WEIGHT) <= least * 1.01 + 1e-6).all()


def test_the_minimum_is_one(photos):
    x = photos(b=1, h=16, w=16, dtype=torch.float64)
    mask = masked(x)
    best = minimise(x, mask, WEIGHT, 600)
    least = objective(best, x, mask, WEIGHT)
    for scale in (1e-1, 1e-2, 1e-3):  # it is convex: no neighbour is lower
        near = best + scale * torch.randn(x.shape, dtype=x.dtype)
        assert (objective(near, x, mask, WEIGHT) > least).all()
    assert (objective(best * 0.99, x, mask, WEIGHT) > least).all()


def test_without_a_mask_it_is_another_solvers(photos):
    x = photos(b=1, h=16, w=20, dtype=torch.float64)
    settings = {"weight": WEIGHT, "eps": 1e-13, "max_num_iter": 1500, "channel_axis": 0}
    wanted = torch.from_numpy(denoise_tv_chambolle(x[0].numpy(), **settings))
    ours = minimise(x, torch.ones_like(x), WEIGHT, 400)[0]
    assert (ours - wanted).abs().max() < 1e-3
    # half the data term would be noticed
    other = minimise(x, torch.ones_like(x), 2 * WEIGHT, 400)[0]
    assert (other - wanted).abs().max() > 1e-2


def test_a_flat_image_stays_flat():
    images = torch.tensor([0.0, 0.37, 1.0]).view(3, 1, 1, 1).expand(3, 3, 19, 23)
    assert torch.allclose(TotalVariation()(images), images, atol=1e-6)


def test_what_was_thrown_away_leaves_no_trace(photos):
    x = photos(b=1)
    mask = masked(x)
    other = torch.where(mask > 0, x, torch.rand(x.shape))
    for n in (1, 100):
        assert torch.equal(minimise(x, mask, WEIGHT, n), minimise(other, mask, WEIGHT, n))


def test_each_number_is_kept_by_its_own_draw(photos):
    """Also in a batch so large that it is solved in parts."""
    images, defence = photos(b=20, h=64, w=64), TotalVariation(keep=0.3, iterations=1)
    assert images.numel() > variation.MAX_NUMBERS_PER_PASS
    torch.manual_seed(1)
    found = defence(images)
    torch.manual_seed(1)
    mask = (torch.rand(images.shape) < 0.3).to(images)
    assert torch.equal(found, minimise(images, mask, WEIGHT, 1).clamp(0, 1))


def test_holes_are_filled_from_what_is_near():
    x = torch.zeros(1, 1, 8, 8)
    x[..., :4] = 0.2
    x[..., 4:] = 0.8
    mask = torch.zeros_like(x)
    mask[0, 0, 0, 0] = mask[0, 0, 7, 7] = mask[0, 0, 0, 7] = mask[0, 0, 7, 0] = 1
    assert torch.allclose(fill(x, mask), x)
    assert torch.equal(fill(x, torch.zeros_like(x)), torch.full_like(x, 0.5))
    assert torch.equal(fill(x, torch.ones_like(x)), x)
