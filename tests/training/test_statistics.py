"""Intervals of simulated tables of seeds and images: they hold the truth as often as they say."""

import numpy as np
import pytest

from moireaug.evaluation import wilson
from training.comparison.intervals import difference_interval, rate_interval, t_interval

TABLES = 400


def two_way(rng, seeds, images, between, level):
    """Outcomes with scatter of seeds and of images, and the accuracy that they are draws of."""
    difficulty = rng.normal(0, 1, images)
    skill = level + between * rng.normal(0, 1, seeds)
    return (skill[:, None] + difficulty + rng.normal(0, 1, (seeds, images)) > 0).astype(float)


def paired(rng, seeds, images, between, lead):
    """Differences of two recipes that find the same images difficult."""
    difficulty = rng.normal(0, 1, images)
    skills = between * rng.normal(0, 1, (2, seeds, 1)) + np.array([lead, 0.0])[:, None, None]
    ours, theirs = skills + difficulty + rng.normal(0, 1, (2, seeds, images)) > 0
    return ours.astype(float) - theirs


def coverage(interval, table, seeds, *scatter, seed):
    """Return the truth, the share of simulated tables whose interval holds it, and their median
    width."""
    rng = np.random.default_rng(seed)
    truth = np.mean([table(rng, 1, 2000, *scatter).mean() for _ in range(2000)])
    bounds = [interval(table(rng, seeds, 200, *scatter)) for _ in range(TABLES)]
    low, high = np.transpose(bounds)
    return truth, np.mean((low <= truth) & (truth <= high)), np.median(high - low)


@pytest.mark.parametrize("seeds", [2, 3, 5])
@pytest.mark.parametrize(("between", "level"), [(0.0, 0.3), (0.3, 0.3), (0.2, 3.0)])
def test_the_interval_of_a_rate_holds_the_truth(seeds, between, level):
    truth, held, width = coverage(rate_interval, two_way, seeds, between, level, seed=0)
    assert held >= 0.93
    low, high = wilson(truth * seeds * 200, seeds * 200)
    assert width > 0.9 * (high - low)  # no narrower than of as many images as outcomes


@pytest.mark.parametrize("seeds", [2, 3, 5])
@pytest.mark.parametrize(("between", "lead"), [(0.0, 0.0), (0.1, 0.2), (0.4, 0.2)])
def test_the_interval_of_a_difference_holds_the_truth(seeds, between, lead):
    assert coverage(difference_interval, paired, seeds, between, lead, seed=1)[1] >= 0.93


def test_intervals_of_three_seeds_can_tell_a_difference():
    rng = np.random.default_rng(2)
    lows = [difference_interval(paired(rng, 3, 200, 0.05, 0.6))[0] for _ in range(TABLES)]
    assert np.mean(np.array(lows) > 0) > 0.8


def test_seeds_that_differ_widen_an_interval_as_student_does():
    """Where images agree, seeds are all that varies."""
    values = np.repeat([[0.1], [0.4], [0.2]], 50, axis=1)
    assert difference_interval(values) == pytest.approx(t_interval([0.1, 0.4, 0.2]), abs=1e-12)


def test_a_single_seed_has_the_interval_of_its_images():
    rng = np.random.default_rng(1)
    outcomes = (rng.random((1, 400)) < 0.3).astype(float)
    assert rate_interval(outcomes) == pytest.approx(wilson(outcomes.sum(), 400))
    half = 1.959964 * outcomes.std(ddof=1) / 20
    expected = (outcomes.mean() - half, outcomes.mean() + half)
    assert difference_interval(outcomes) == pytest.approx(expected)


def test_what_is_all_the_same_keeps_its_width():
    """Both of a rate at 0 and of a difference that is 0 on every image."""
    width = wilson(0, 100)[1]
    assert difference_interval(np.zeros((3, 100))) == pytest.approx((-width, width))
    assert difference_interval(-np.ones((3, 100))) == pytest.approx((-1, width - 1))
    assert rate_interval(np.zeros((3, 100))) == pytest.approx((0, width))
    assert rate_interval(np.ones((3, 100))) == pytest.approx((1 - width, 1))
    # means over scenes, whose deviation is not exactly 0
    assert rate_interval(np.full((3, 100), 0.9)) == pytest.approx(wilson(90, 100))


def test_intervals_stay_in_range():
    """Of one image, of all but one outcome the same, and of differences at their bounds."""
    assert 0 <= rate_interval(np.array([[1.0], [0.0]]))[0] <= 1
    nearly = np.ones((3, 50))
    nearly[0, 0] = 0
    low, high = rate_interval(nearly)
    assert 0.8 < low < nearly.mean() < high <= 1
    low, high = difference_interval(np.where(nearly == 0, -1.0, 1.0))
    assert low < nearly.mean() < high == 1
