"""Intervals of simulated tables of seeds and images: they hold the truth as often as they say."""

import numpy as np
import pytest

from moireaug.evaluation import wilson
from training.comparison.summaries import bootstrap


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
