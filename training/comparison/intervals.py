"""95 % intervals of means over seeds, or over seeds and the images that all of them saw."""

import math
from collections.abc import Sequence
from statistics import fmean, stdev
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from moireaug.evaluation.statistics import Z95, wilson

ROUNDING_ERROR = 1e-12  # of equal outcomes


def t_interval(values: Sequence[float]) -> tuple[float, float]:
    """Return the interval of the mean of two or more measurements (Student, 1908)."""
    half = _quantile(len(values) - 1) * stdev(values) / math.sqrt(len(values))
    return fmean(values) - half, fmean(values) + half


def rate_interval(correct: np.ndarray) -> tuple[float, float]:
    """Return the interval of an accuracy, for the choice of seeds and images: Wilson's of as many
    independent images as scatter as much. Of a single seed, Wilson's of its images.

    Args:
        correct: (seeds, images) in [0, 1], the same images in every row.
    """
    seeds, images = correct.shape
    rate = float(correct.mean())
    n = float(images)
    if seeds > 1 and np.ptp(correct) > ROUNDING_ERROR:
        variance, freedom = _scatter(correct)
        n = rate * (1 - rate) / variance * (Z95 / _quantile(freedom)) ** 2
        n = min(n, correct.size)
    low, high = wilson(rate * n, n)
    return float(min(low, rate)), float(max(high, rate))  # rounding may leave 0 or 1 out


def difference_interval(differences: np.ndarray) -> tuple[float, float]:
    """Return the interval of a mean difference, for the choice of seeds and images. Where all
    differences are the same, it is as wide as Wilson's of no hit among so many images.

    Args:
        differences: (seeds, images) in [-1, 1], the same images in every row.
    """
    mean = float(differences.mean())
    if np.ptp(differences) < ROUNDING_ERROR:
        half = wilson(0, differences.shape[1])[1]
    else:
        variance, freedom = _scatter(differences)
        half = _quantile(freedom) * math.sqrt(variance)
    return float(max(-1.0, mean - half)), float(min(1.0, mean + half))


class Scatter(NamedTuple):
    """Variance of a mean, and the degrees of freedom of its estimate."""

    variance: float
    freedom: float


def _scatter(values: np.ndarray) -> Scatter:
    """Return how a mean scatters with the choice of seeds and images, both random, by the analysis
    of variance that ROC studies use for readers and cases (Hillis, 2007).

    Args:
        values: (seeds, images).
    """
    seeds, images = values.shape
    by_seed, by_image = values.mean(1, keepdims=True), values.mean(0, keepdims=True)
    mean_square_image = seeds * by_image.var(ddof=1) if images > 1 else 0.0
    if seeds == 1:
        return Scatter(mean_square_image / images, math.inf)
    rest = values - by_seed - by_image + values.mean()
    mean_square_rest = (rest**2).sum() / ((seeds - 1) * max(images - 1, 1))
    # seeds that agree by chance are not more alike than their images let them be
    mean_square_seed = max(images * by_seed.var(ddof=1), mean_square_rest)
    both = mean_square_seed + max(mean_square_image - mean_square_rest, 0.0)
    freedom = (seeds - 1) * (both / mean_square_seed) ** 2 if mean_square_seed else math.inf
    return Scatter(both / values.size, freedom)


def _quantile(freedom: float) -> float:
    """Return Student's t, which 97.5 % lie below."""
    return Z95 if math.isinf(freedom) else float(stdtrit(freedom, 0.975))
