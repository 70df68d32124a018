"""The heads of the detector of screen photos, and the measures that judge its scores."""

import tracemalloc

import numpy as np
import pytest
import torch

from training.detection import measures as measuring
from training.detection.heads import LOOKS, fit_head
from training.detection.labelled import LabelledPhotos, cross_validated, heads_of
from training.detection.measures import (
    auc,
    equal_error_rate,
    found_at,
    measures,
    threshold_at,
)
from training.report.plots import png

NONE = {look: [] for look in LOOKS}


def test_error_rates_count_scores_that_are_equal():
    rng = np.random.default_rng(0)
    for count in (1, 2, 7, 30):
        screens, others = rng.integers(0, 6, count + 3) / 5, rng.integers(0, 6, count) / 7
        thresholds = np.sort(np.concatenate((screens, others, [np.inf])))
        expected = (screens[:, None] >= thresholds).mean(0)
        assert np.array_equal(measuring.share_from(screens, thresholds), expected)
        missed = (screens[:, None] < thresholds[:-1]).mean(0)
        alarms = (others[:, None] >= thresholds[:-1]).mean(0)
        nearest = np.abs(missed - alarms).argmin()
        assert equal_error_rate(screens, others) == (missed[nearest] + alarms[nearest]) / 2


def test_error_rates_of_many_scores_take_little_memory():
    scores = np.random.default_rng(0).random(20_000)
    tracemalloc.start()
    equal_error_rate(scores, scores)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 100 * scores.nbytes


def test_measures_are_those_of_small_examples():
    screens, others = np.array([3.0, 2.0, 1.0]), np.array([0.0, 1.5])
    assert auc(screens, others) == pytest.approx(5 / 6)
    assert auc(others, others) == 0.5
    assert equal_error_rate(np.array([1.0, 2.0]), np.array([0.0, 0.5])) == 0
    assert found_at(screens, np.arange(10) / 10, 0.1) == 3
    assert found_at(screens, np.array([*np.zeros(8), 1.5, 2.5]), 0.1) == 2  # one of ten may exceed
    assert found_at(screens, np.array([*np.zeros(7), 1.5, 2.5]), 0.1) == 1  # of nine none may
    found = measures(screens, others, 1.2)
    assert found["apcer"] == pytest.approx(1 / 3) and found["bpcer"] == 0.5
    assert measures(screens, others, None) == {k: v for k, v in found.items() if "pcer" not in k}
    low, high = found["auc_interval"]
    assert low <= found["auc"] <= high


def test_a_head_is_the_penalised_logistic_regression():
    generator = torch.Generator().manual_seed(0)
    x = torch.randn(60, 4, generator=generator) * torch.tensor([1.0, 5.0, 0.1, 1.0]) + 2
    truth = x[:, 0] + 0.1 * x[:, 1] > 2.5
    head = torch.nn.Linear(4, 1)
    fit_head(head, [(x, truth)], penalty=0.1)
    loss = torch.nn.functional.binary_cross_entropy_with_logits
    share = truth.float().mean()
    balance = torch.where(truth, 0.5 / share, 0.5 / (1 - share))
    std = x.std(0)

    def objective(weight, bias):
        total = loss(x @ weight + bias, truth.float(), balance)
        return total + 0.05 * (weight * std).square().sum()

    weight = head.weight.detach()[0].requires_grad_()
    bias = head.bias.detach()[0].requires_grad_()
    objective(weight, bias).backward()
    assert (weight.grad * std).abs().max() < 1e-3 and bias.grad.abs() < 1e-3


def test_parts_of_examples_weigh_the_same():
    """Few examples of a part that contradict many of another one tie with them."""
    many, few = torch.randn(400, 1, generator=torch.Generator().manual_seed(0)), torch.ones(4, 1)
    few[:2] = -1
    head = torch.nn.Linear(1, 1)
    fit_head(head, [(many, many[:, 0] > 0)], penalty=0.01)
    alone = head.weight.item()
    contradicting = few, few[:, 0] < 0
    fit_head(head, [(many.sign(), many[:, 0] > 0), contradicting], penalty=0.01)
    assert alone > 1 and abs(head.weight.item()) < 0.05


def test_curves_of_folders_of_any_name_are_drawn(monkeypatch):
    figures = []
    monkeypatch.setattr(measuring, "png", lambda figure: figures.append(figure) or png(figure))
    scores = np.array([1.0, 2.0]), np.array([0.0, 1.0])
    assert measuring.roc_plot(dict.fromkeys(["_own", "5$_and_$", "caf\udce9"], scores))
    legend = figures[0].axes[0].get_legend()
    assert [text.get_text() for text in legend.get_texts()] == [
        "_own, 0.88",
        "5$_and_$, 0.88",
        "caf?, 0.88",
    ]


def test_each_source_sets_as_much_of_the_threshold():
    rng = np.random.default_rng(0)
    few, many = rng.normal(2, 1, 40), rng.normal(0, 1, 2000)
    assert threshold_at(0.1, [few]) == pytest.approx(np.quantile(few, 0.9))
    threshold = threshold_at(0.1, [few, many])
    assert np.mean([(part > threshold).mean() for part in (few, many)]) == pytest.approx(
        0.1, abs=0.02
    )
    assert threshold_at(0.0, [few, many]) == max(few.max(), many.max())


def photos_of(seed, count):
    """Labelled photos of random features, each beside another one of the same scene."""
    crops = torch.randn(count // 2, 5, 64, generator=torch.Generator().manual_seed(seed))
    crops = crops.repeat_interleave(2, 0)
    is_screen = torch.arange(count) >= count // 2
    names = [str(number) for number in range(count)]
    return LabelledPhotos(names, crops, crops.mean(1), is_screen)


def test_photos_are_left_out_with_their_neighbours():
    """Heads know by heart what trains them, and nothing of what does not."""
    found, known = [], []
    for seed in range(8):
        photos = photos_of(seed, 20)
        heads = heads_of(photos, NONE, 0.5)
        scores = heads(photos.crops, photos.wholes).detach().numpy()
        truth = photos.is_screen.numpy()
        known.append(auc(scores[truth], scores[~truth]))
        left_out = cross_validated(photos, NONE, 0.5)
        found.append(auc(left_out.screens, left_out.others))
    assert min(known) > 0.99 and 0.3 < np.mean(found) < 0.65


def test_one_photo_of_a_kind_cannot_be_left_out():
    photos = photos_of(0, 20)
    chosen = torch.arange(20) < 11
    assert cross_validated(photos.subset(chosen), NONE, 0.5) is None
    assert cross_validated(photos.subset(torch.arange(20) < 12), NONE, 0.5).screens.shape == (2,)
