"""What the runner does to a model: it is left as it was found, wherever it is."""

import pytest
import torch
from torch import nn

from moireaug.evaluation.conditions import Clean, Photo
from moireaug.evaluation.corruptions import Corrupted
from moireaug.evaluation.judges import Judge
from moireaug.evaluation.suites.trust import CleanTwice, PhotoGradient
from tests.evaluation.haze import CONDITIONS, ran, results, table_of

from .conftest import classifier


@pytest.mark.parametrize(
    ("part", "body"),
    [
        ("model", nn.Sequential(classifier(), nn.BatchNorm1d(4))),
        ("defence", nn.BatchNorm2d(3)),
        ("attacked", nn.Sequential(classifier(), nn.BatchNorm1d(4))),
    ],
)
def test_a_model_or_defence_is_left_as_it_was_found(part, body, known):
    """It judges in evaluation mode, without gradients, and keeps its statistics."""
    seen = []

    class Spy(nn.Module):
        def forward(self, x):
            seen.append((self.training, torch.is_grad_enabled()))
            return x

    stranger = nn.Sequential(body, Spy()).train()
    state = {k: v.clone() for k, v in stranger.state_dict().items()}
    if part == "attacked":
        ran((stranger, known[1]), table_of(Photo()))
    else:
        ran(known, table_of(Photo(), judge=Judge("stranger", **{part: stranger})))
    assert seen and not any(training or grad for training, grad in seen)
    assert stranger.training
    assert all(torch.equal(v, stranger.state_dict()[k]) for k, v in state.items())


def test_a_model_that_returns_no_logits_or_one_gets_a_sentence(known):
    bad = Judge("bad", model=lambda shown: shown)
    with pytest.raises(ValueError, match=r"must return logits \(B, K\)"):
        ran(known, table_of(Clean(), judge=bad), (0,))
    with pytest.raises(ValueError, match="logits of at least two classes; got 1"):
        ran((lambda x: x.mean((1, 2, 3))[:, None], known[1]), indices=(0,))


def test_another_default_device_changes_nothing(known):
    table = table_of(*CONDITIONS.values(), Corrupted(corruption="gaussian_noise", amount=0.1))
    plain = results(ran(known, table, (0,)))
    with torch.device("meta"):
        assert results(ran(known, table, (0,))) == plain


def test_a_model_may_work_in_place(known):
    model, batches = known
    conditions, answers = (*CONDITIONS.values(), CleanTwice(), PhotoGradient()), []
    for one in (lambda x: model(x - 0.1), lambda x: model(x.sub_(0.1))):
        found = results(ran((one, batches), table_of(*conditions), (0,))).values()
        answers.append([(record["predicted"], record["measured"]) for record in found])
    assert answers[0] == answers[1]


def test_a_defence_may_work_in_place_and_is_clipped(known):
    model, batches = known
    kept = [images.clone() for images, _ in batches]
    answers = []
    for defence in (lambda x: (x * 3).clamp(0, 1), lambda x: x.mul_(3)):
        judge = Judge("defence", defence=defence)
        runner = ran((model, batches), table_of(Clean(), Photo(), judge=judge), (0,))
        answers.append([record["predicted"] for record in results(runner).values()])
    assert answers[0] == answers[1]
    assert all(torch.equal(a, b) for a, (b, _) in zip(kept, batches, strict=True))


def test_devices_without_the_model_are_left_alone(known, monkeypatch):
    monkeypatch.setattr(torch.cuda, "device_count", None)  # which cannot be called
    assert results(ran(known, table_of(Photo()), (0,)))
