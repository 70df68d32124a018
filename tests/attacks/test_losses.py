"""Losses of attacks: closed forms, gradients, and logits that are saturated, equal or too few."""

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


@pytest.mark.parametrize("name", LOSSES)
@pytest.mark.parametrize("targeted", [False, True])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_values_are_those_of_the_papers(name, targeted, dtype):
    found = LOSSES[name](LOGITS.to(dtype), LABELS, TARGETS if targeted else None)
    expected = []
    for z, y, t in zip(LOGITS.tolist(), LABELS.tolist(), TARGETS.tolist(), strict=True):
        expected.append(by_hand(name, z, y, t if targeted else None))
    assert torch.allclose(found.double(), torch.tensor(expected).double(), rtol=1e-5)


@pytest.mark.parametrize("name", LOSSES)
@pytest.mark.parametrize("targeted", [False, True])
def test_gradients_are_those_of_the_values(name, targeted):
    logits = LOGITS.clone().requires_grad_()
    targets = TARGETS if targeted else None
    assert torch.autograd.gradcheck(lambda z: LOSSES[name](z, LABELS, targets), logits)


@pytest.mark.parametrize("targeted", [False, True])
def test_the_ratio_does_not_depend_on_scale_or_shift(targeted):
    targets = TARGETS if targeted else None
    expected = LOSSES["dlr"](LOGITS, LABELS, targets)
    for scale in (1e-4, 1.0, 1e4):
        assert torch.allclose(LOSSES["dlr"](LOGITS * scale + 3 * scale, LABELS, targets), expected)


@pytest.mark.parametrize("name", LOSSES)
@pytest.mark.parametrize("targeted", [False, True])
def test_saturated_logits_still_lead_away_from_the_label(name, targeted):
    """Softmax of these is exactly 0 and 1 in float32, and cross-entropy itself has no gradient."""
    logits = (LOGITS * 1e4).float().requires_grad_()
    plain = torch.nn.functional.cross_entropy(logits[:1], LABELS[:1])
    assert not torch.autograd.grad(plain, logits)[0].any()
    loss = LOSSES[name](logits, LABELS, TARGETS if targeted else None)
    (slope,) = torch.autograd.grad(loss.sum(), logits)
    rows = torch.arange(3)
    assert loss.isfinite().all() and slope.isfinite().all()
    assert (slope.abs().amax(1) * 1e4 > 0.01).all()
    if targeted:
        assert (slope[rows, TARGETS] > 0).all()
    else:
        assert (slope[rows, LABELS] < 0).all()


@pytest.mark.parametrize("name", LOSSES)
@pytest.mark.parametrize("targeted", [False, True])
@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float32, torch.float64])
@pytest.mark.parametrize("ties", [5, 4, 3, 2])
def test_ties_give_finite_losses_with_finite_gradients(name, targeted, dtype, ties):
    logits = torch.zeros(3, 5, dtype=dtype)
    logits[:, ties:] = -1
    logits.requires_grad_()
    loss = LOSSES[name](
        logits, torch.tensor([0, 1, 4]), torch.tensor([1, 4, 0]) if targeted else None
    )
    (slope,) = torch.autograd.grad(loss.sum(), logits)
    assert loss.isfinite().all() and slope.isfinite().all()
    assert slope.any(1).all()


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


@pytest.mark.parametrize(
    ("classes", "targeted", "sentence"),
    [
        (
            2,
            False,
            "the loss 'dlr' needs a model of at least 3 classes; got logits of 2. Use 'margin'.",
        ),
        (
            3,
            True,
            "the loss 'dlr', targeted, needs a model of at least 4 classes; got logits of 3. Use "
            "'margin'.",
        ),
    ],
)
def test_too_few_classes_are_refused(classes, targeted, sentence):
    with pytest.raises(ValueError) as error:
        LOSSES["dlr"](
            torch.zeros(1, classes), torch.tensor([0]), torch.tensor([1]) if targeted else None
        )
    assert str(error.value) == sentence


def test_the_margin_is_positive_where_the_attack_is_there():
    z = torch.tensor([[1.0, 2.0, 0.0], [3.0, 2.0, 0.0]])
    labels, targets = torch.tensor([0, 0]), torch.tensor([1, 1])
    assert margin(z, labels).tolist() == [1, -1]
    assert margin(z, labels, targets).tolist() == [1, -1]
    assert margin(z, labels, torch.tensor([2, 2])).tolist() == [-2, -3]


@pytest.mark.parametrize("targets", [None, torch.tensor([1])], ids=["untargeted", "targeted"])
def test_dlr_goes_on_where_classes_are_ruled_out(targets):
    """With fewer finite logits than the ratio takes, it is the difference alone."""
    logits = torch.tensor([[2.0, 1.0, -torch.inf, -torch.inf, -torch.inf]], requires_grad=True)
    loss = LOSSES["dlr"](logits, torch.tensor([0]), targets)
    (grad,) = torch.autograd.grad(loss.sum(), logits)
    assert loss.tolist() == [-1]
    assert grad.tolist() == [[-1, 1, 0, 0, 0]]
