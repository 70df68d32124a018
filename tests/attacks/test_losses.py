"""Losses of attacks: closed forms, gradients, and logits that are saturated, equal or too few."""

import itertools
import math

import pytest
import torch

from moireaug.attacks import LOSSES, margin

LOGITS = torch.tensor(
    [[4.0, 1.0, 2.0, -3.0, 0.5], [0.0, 1.0, 5.0, 3.0, -2.0], [-1.0, 7.0, 6.9, 0.0, 2.0]],
    dtype=torch.float64,
)
LABELS = torch.tensor([0, 0, 2])
TARGETS = torch.tensor([2, 1, 4])
every_loss = pytest.mark.parametrize("name", LOSSES)
with_and_without_targets = pytest.mark.parametrize("targets", [None, TARGETS], ids=["un", "t"])


def by_hand(name, z, y, t):
    """One image's loss, from sorted logits as the papers print it."""
    others = [value for k, value in enumerate(z) if k != (y if t is None else t)]
    top = sorted(z, reverse=True)
    if name == "dlr" and t is None:
        return -(z[y] - max(others)) / (top[0] - top[2])
    if name == "dlr":
        return -(z[y] - z[t]) / (top[0] - (top[2] + top[3]) / 2)
    goal, sign = (y, 1) if t is None else (t, -1)
    if name == "margin":
        return sign * (max(others) - z[goal])
    share = math.exp(z[goal]) / sum(math.exp(value) for value in z)
    return sign * (math.log(1 - share) - math.log(share))


@every_loss
@with_and_without_targets
def test_values_are_those_of_the_papers_and_gradients_theirs(name, targets):
    goals = [None] * 3 if targets is None else targets.tolist()
    rows = zip(LOGITS.tolist(), LABELS.tolist(), goals, strict=True)
    expected = torch.tensor([by_hand(name, *row) for row in rows]).double()
    for dtype in (torch.float32, torch.float64):
        loss = LOSSES[name](LOGITS.to(dtype), LABELS, targets)
        assert torch.allclose(loss.double(), expected, rtol=1e-5), dtype
    logits = LOGITS.clone().requires_grad_()
    assert torch.autograd.gradcheck(lambda z: LOSSES[name](z, LABELS, targets), logits)


@with_and_without_targets
def test_the_ratio_does_not_depend_on_scale_or_shift(targets):
    expected = LOSSES["dlr"](LOGITS, LABELS, targets)
    for scale in (1e-4, 1.0, 1e4):
        assert torch.allclose(LOSSES["dlr"](LOGITS * scale + 3 * scale, LABELS, targets), expected)


@every_loss
@with_and_without_targets
def test_saturated_logits_still_lead_away_from_the_label(name, targets):
    """Softmax of these is exactly 0 and 1 in float32, and cross-entropy itself has no gradient."""
    logits = (LOGITS * 1e4).float().requires_grad_()
    plain = torch.nn.functional.cross_entropy(logits[:1], LABELS[:1])
    assert not torch.autograd.grad(plain, logits)[0].any()
    loss = LOSSES[name](logits, LABELS, targets)
    (slope,) = torch.autograd.grad(loss.sum(), logits)
    assert loss.isfinite().all() and slope.isfinite().all()
    assert (slope.abs().amax(1) * 1e4 > 0.01).all()
    goal, sign = (LABELS, -1) if targets is None else (targets, 1)
    assert (sign * slope[torch.arange(3), goal] > 0).all()


@every_loss
def test_ties_give_finite_losses_with_finite_gradients(name):
    dtypes = (torch.float16, torch.bfloat16, torch.float32, torch.float64)
    for case in itertools.product(dtypes, (5, 4, 3, 2), (None, torch.tensor([1, 4, 0]))):
        dtype, ties, targets = case
        logits = torch.zeros(3, 5, dtype=dtype)
        logits[:, ties:] = -1
        loss = LOSSES[name](logits.requires_grad_(), torch.tensor([0, 1, 4]), targets)
        (slope,) = torch.autograd.grad(loss.sum(), logits)
        assert loss.isfinite().all() and slope.isfinite().all() and slope.any(1).all(), case


def test_logits_that_all_tie_have_a_ratio_of_0():
    for targets in (None, torch.tensor([1, 2])):
        assert LOSSES["dlr"](torch.zeros(2, 4), torch.tensor([0, 1]), targets).tolist() == [0, 0]


def test_the_ratio_goes_on_where_the_label_is_third():
    """There the paper's has no gradient."""
    logits = torch.tensor([[4.0, 1.0, 2.0, -3.0]], requires_grad=True)
    loss = LOSSES["dlr"](logits, torch.tensor([1]))
    assert loss.item() == 1
    (gradient,) = torch.autograd.grad(loss, logits)
    assert gradient[0, 1] < 0 < gradient[0, 0]


def test_too_few_classes_for_the_ratio_are_refused():
    wanted = "at least {} classes; got logits of {}. Use 'margin'."
    for classes, targets in ((2, None), (3, torch.tensor([1]))):
        with pytest.raises(ValueError) as error:
            LOSSES["dlr"](torch.zeros(1, classes), torch.tensor([0]), targets)
        assert wanted.format(classes + 1, classes) in str(error.value)


def test_the_margin_is_positive_where_the_attack_is_there():
    z = torch.tensor([[1.0, 2.0, 0.0], [3.0, 2.0, 0.0]])
    labels, targets = torch.tensor([0, 0]), torch.tensor([1, 1])
    assert margin(z, labels).tolist() == [1, -1]
    assert margin(z, labels, targets).tolist() == [1, -1]
    assert margin(z, labels, torch.tensor([2, 2])).tolist() == [-2, -3]


def test_the_ratio_goes_on_where_classes_are_ruled_out():
    """With fewer finite logits than the ratio takes, it is the difference alone."""
    for targets in (None, torch.tensor([1])):
        logits = torch.tensor([[2.0, 1.0, -torch.inf, -torch.inf, -torch.inf]], requires_grad=True)
        loss = LOSSES["dlr"](logits, torch.tensor([0]), targets)
        (grad,) = torch.autograd.grad(loss.sum(), logits)
        assert loss.tolist() == [-1] and grad.tolist() == [[-1, 1, 0, 0, 0]], targets
