"""Intervals: published values, and simulated pairs whose truth they hold as often as they say."""

import pandas as pd
import pytest
import torch

from moireaug.evaluation import paired_gain, rates, wilson
from moireaug.evaluation.conditions import Photo
from tests.evaluation.conftest import classifier
from tests.evaluation.haze import frame_of, table_of


def test_wilson_against_published_values():
    assert wilson(0, 10) == pytest.approx((0.0, 0.278), abs=1e-3)
    assert wilson(5, 10) == pytest.approx((0.237, 0.763), abs=1e-3)
    assert wilson(10, 10) == pytest.approx((0.722, 1.0), abs=1e-3)


def test_nothing_leaves_the_interval_open():
    none = torch.zeros(0, dtype=torch.bool)
    assert wilson(0, 0) == (0.0, 1.0)
    assert paired_gain(none, none) == (0.0, -1.0, 1.0)


def test_paired_gain_covers_the_truth():
    """Of simulated pairs, about 95 times of 100; unpaired draws widen it."""
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


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: wilson(6, 5), r"hits must lie in \[0, n\]; got 6 of 5"),
        (lambda: paired_gain("1", "0"), "must be bool, .n,.; got <U1"),
        (lambda: paired_gain(torch.ones(5), torch.ones(5)), "must be bool, .n,.; got float32"),
        (lambda: paired_gain(torch.ones(5) > 0, torch.ones(5, 1) > 0), r"\(n,\); got \(5,\) and"),
    ],
)
def test_outcomes_of_another_form_are_refused(call, said):
    with pytest.raises((ValueError, TypeError), match=said):
        call()


def test_a_gain_is_of_the_columns_of_two_frames(known):
    model, batches = known
    frames = [frame_of((one, batches), table_of(Photo())) for one in (model, classifier(1))]
    columns = [frame["correct"] for frame in frames]
    columns[1].index += 3  # images are matched by their order
    tensors = [torch.tensor(column.to_numpy()) for column in columns]
    assert paired_gain(*columns) == paired_gain(*tensors)


def test_rates_of_joined_evaluations_are_refused(known):
    """Two models would be pooled as if they were one, on twice as many images."""
    frame = frame_of(known, table_of(Photo()))
    joined = pd.concat([frame.assign(model=name) for name in ("a", "b")])
    with pytest.raises(ValueError, match=r"image 0 twice in the row 'moire'.*Join their rates"):
        rates(joined)
