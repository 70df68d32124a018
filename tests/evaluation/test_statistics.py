"""Intervals: published values, and simulated tables whose truth they hold as often as they say."""

import numpy as np
import pytest
import torch

from moireaug.evaluation import paired_gain, wilson
from moireaug.evaluation.statistics import bootstrap


@pytest.mark.parametrize(
    ("hits", "n", "expected"),
    [(0, 10, (0.0, 0.278)), (5, 10, (0.237, 0.763)), (10, 10, (0.722, 1.0)), (0, 0, (0.0, 1.0))],
)
def test_wilson_against_published_values(hits, n, expected):
    assert wilson(hits, n) == pytest.approx(expected, abs=1e-3)


def test_no_pairs_leave_the_gain_open():
    none = torch.zeros(0, dtype=torch.bool)
    assert paired_gain(none, none) == (0.0, -1.0, 1.0)


def test_paired_gain_covers_the_truth():
    """Simulated pairs: the 95 % interval holds the true difference about 95 times of 100; unpaired
    draws widen it."""
    g, covered, widths = torch.Generator().manual_seed(0), 0, []
    for _ in range(400):
        u = torch.rand(200, generator=g)
        theirs, ours = u < 0.5, u < 0.6
        flip = torch.rand(200, generator=g) < 0.1
        ours = ours ^ flip
        gain, low, high = paired_gain(ours, theirs)
        truth = 0.6 * 0.9 + 0.4 * 0.1 - 0.5
        covered += low <= truth <= high
        widths.append(high - low)
        assert low <= gain <= high
    assert 0.92 <= covered / 400 <= 0.985
    shuffled = paired_gain(ours, theirs[torch.randperm(200, generator=g)])
    assert shuffled[2] - shuffled[1] > 1.3 * sum(widths) / len(widths)


def two_way(rng, seeds, images, between):
    """Outcomes with scatter of seeds and of images, and the accuracy that they are draws of."""
    difficulty = rng.normal(0, 1, images)
    skill = 0.3 + between * rng.normal(0, 1, seeds)
    return (skill[:, None] + difficulty + rng.normal(0, 1, (seeds, images)) > 0).astype(float)


@pytest.mark.parametrize("between", [0.0, 0.3, 0.6])
def test_the_bootstrap_holds_seeds_and_images(between):
    """Simulated tables of three seeds: the interval holds the truth as often as it says."""
    rng = np.random.default_rng(0)
    truth = np.mean([two_way(rng, 1, 2000, between).mean() for _ in range(2000)])
    covered = 0
    widths = []
    for _ in range(200):
        outcomes = two_way(rng, 3, 200, between)
        low, high = bootstrap(outcomes, draws=400)
        covered += low <= truth <= high
        widths.append(high - low)
        assert low <= outcomes.mean() <= high
    assert covered / 200 >= 0.935
    alone = wilson(0.58 * 200, 200)
    assert np.median(widths) > alone[1] - alone[0]  # three seeds are not six hundred images
    assert np.median(widths) < (3 + 20 * between) * (alone[1] - alone[0])  # and it says something


def test_the_bootstrap_of_one_seed_is_that_of_its_images():
    rng = np.random.default_rng(1)
    outcomes = (rng.random((1, 400)) < 0.3).astype(float)
    low, high = bootstrap(outcomes)
    expected = wilson(outcomes.sum(), 400)
    assert (low, high) == pytest.approx(expected, abs=0.01)


def test_the_bootstrap_of_what_is_all_the_same_keeps_its_width():
    """Both of a rate at 0 and of a difference that is 0 on every image."""
    width = wilson(0, 100)[1]
    assert bootstrap(np.zeros((3, 100))) == pytest.approx((-width, width))
    assert bootstrap(np.ones((3, 100))) == pytest.approx((1 - width, 1))
    assert bootstrap(-np.ones((3, 100))) == pytest.approx((-1, width - 1))
    # means over scenes, whose deviation is not exactly 0
    assert bootstrap(np.full((3, 100), 0.9)) == pytest.approx((0.9 - width, 0.9 + width))


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: wilson(6, 5), r"hits must lie in \[0, n\]; got 6 of 5"),
        (lambda: paired_gain([True], [False]), "bool tensor .n,.; got list"),
        (lambda: paired_gain(torch.ones(5), torch.ones(5)), "bool tensor .n,.; got torch.float32"),
        (
            lambda: paired_gain(torch.ones(5).bool(), torch.zeros(5, 1).bool()),
            r"one shape \(n,\); got \(5,\) and \(5, 1\)",
        ),
    ],
)
def test_outcomes_of_another_form_are_refused(call, said):
    with pytest.raises((ValueError, TypeError), match=said):
        call()
