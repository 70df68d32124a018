"""The disc of a patch: where it lies, how large it is, and that nothing beside it changes."""

import math

import pytest
import torch

from moireaug.attacks import PGD, MultiTargeted, Patch
from moireaug.attacks.pixel import discs

SQUARE, WIDE = (64, 64), (72, 96)


def mean(x):
    """Says whether the image is bright."""
    bright = x.mean((1, 2, 3)) - 0.5
    return torch.stack([-bright, bright], 1)


@pytest.mark.parametrize(
    ("area", "size"),
    [(0.01, SQUARE), (0.05, WIDE), (0.3, SQUARE), (0.5, WIDE), (0.7, SQUARE)],
)
def test_a_disc_has_its_area_and_lies_in_the_image(area, size):
    mask = discs(torch.rand(50, 3, *size), area, torch.Generator().manual_seed(0))
    assert mask.unique().tolist() == [0, 1]
    share = mask.mean((1, 2, 3))
    assert (share - area).abs().max() < 0.06 * area + 5 / (size[0] * size[1])
    radius = math.sqrt(area * size[0] * size[1] / math.pi)
    rows, columns = mask.amax(3).sum((1, 2)), mask.amax(2).sum((1, 2))  # none is cut off
    assert ((rows - 2 * radius).abs() <= 1).all() and ((columns - 2 * radius).abs() <= 1).all()
    assert len({tuple(m.flatten().nonzero()[0].tolist()) for m in mask}) > (25 if area < 0.5 else 1)


def test_only_the_disc_changes_and_it_takes_any_colour():
    images = torch.full((8, 3, 32, 32), 0.45)
    labels = torch.zeros(8, dtype=torch.int64)
    g = torch.Generator().manual_seed(1)
    result = Patch(mean, area=0.3, steps=20)(images, labels, generator=g)
    mask = discs(images, 0.3, torch.Generator().manual_seed(1)).expand(-1, 3, -1, -1)
    assert result.success.all()
    assert result.images[mask == 0].eq(0.45).all() and not result.noise[mask == 0].any()
    assert result.images[mask == 1].eq(1).all(), "white is the brightest that a disc can be"


def test_a_disc_that_is_too_small_fools_nobody():
    """At 5 % of the area, white adds 0.0275 to a mean of 0.45: short of 0.5."""
    images, labels = torch.full((4, 3, 32, 32), 0.45), torch.zeros(4, dtype=torch.int64)
    result = Patch(mean, steps=20)(images, labels)
    assert not result.success.any()
    assert PGD(mean, eps=0.06, steps=20)(images, labels).success.all()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Patch(mean, area=0), "area must be"),
        (lambda: Patch(mean, area=0.8), "area must be"),
        (lambda: Patch(mean, area=math.nan), "area must be"),
        (lambda: discs(torch.rand(1, 3, 20, 1000), 0.5), "fit .* got 113 pixels, 0.5 of the area"),
        (lambda: discs(torch.rand(1, 3, 20, 20), 0.003), "at least 1.42 .* got 1.24 pixels"),
        (lambda: Patch(mean)(torch.rand(1, 3, 8, 8), torch.tensor([0]), shot=0), "no camera"),
    ],
)
def test_what_is_no_disc_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_noise_stays_inside_the_disc():
    images = torch.rand(8, 3, 24, 24)
    labels = images.mean((2, 3)).argmax(1)  # the brightest channel
    settings = {"model": lambda x: x.mean((2, 3)), "area": 0.1, "eps": 0.02}
    disc = discs(images, 0.1, torch.Generator().manual_seed(2))
    for attack in (
        Patch(**settings, restarts=5, steps=1),
        Patch(**settings, random_start=1.0),
        MultiTargeted(Patch(**settings, steps=2), targets=2),
    ):
        noise = attack(images, labels, generator=torch.Generator().manual_seed(2)).noise
        assert noise.any() and not (noise * (1 - disc)).any()
