"""A model that rejects what a detector flags: its last logit, attacks on it, and its evaluation."""

import pytest
import torch
from torch import nn

from moireaug import attacks, evaluation
from moireaug.attacks import predicted
from moireaug.defenses import Compose, Defended, Rejecting
from moireaug.transforms import AdversarialMoire

RED, GREEN = 0, 1


def bright(images):
    """Class 1 where red and green together are brighter than 1; class 2 never wins."""
    lead = 10 * (images[:, RED].mean((1, 2)) + images[:, GREEN].mean((1, 2)) - 1)
    return torch.stack([torch.zeros_like(lead), lead, lead - 20], 1)


def red(images):
    return images[:, RED].mean((1, 2))


@pytest.fixture
def grey():
    return torch.full((4, 3, 8, 8), 0.45), torch.zeros(4, dtype=torch.int64)


def test_the_last_logit_wins_above_the_threshold_alone():
    images = torch.rand(64, 3, 8, 8, generator=torch.Generator().manual_seed(0))
    scores = red(images)
    model = Rejecting(bright, red, scores.quantile(0.5))
    logits = model(images)
    assert torch.equal(logits[:, :-1], bright(images))
    assert torch.equal(logits.argmax(1) == 3, scores > model.threshold)
    assert (predicted(logits, rejects=True) == attacks.REJECTED).sum() == 32


def test_an_attack_goes_around_model_and_detector_together(grey):
    images, labels = grey
    rejecting = Rejecting(bright, red, 0.49)
    settings = {"eps": 0.1, "steps": 40, "step_size": 0.1}
    unaware = attacks.PGD(bright, **settings)(images, labels)
    assert unaware.success.all()
    assert (predicted(rejecting(unaware.images), rejects=True) == attacks.REJECTED).all()
    aware = attacks.PGD(rejecting, **settings)(images, labels)
    assert aware.success.all() and (red(aware.images) <= 0.49).all()
    assert (bright(aware.images).argmax(1) == 1).all()


def test_no_attack_succeeds_where_everything_is_rejected(grey):
    model, settings = Rejecting(bright, red, -9.0), {"eps": 0.5, "steps": 3}
    for attack in (
        attacks.MoireAttack(model, **settings),
        attacks.SquareMoire(model, **settings),
        attacks.PGD(model, until_fooled=True, **settings),
        attacks.CW(model, steps=3),
        attacks.MultiTargeted(attacks.PGD(model, **settings)),
        attacks.PGD(attacks.Normalized(model), **settings),
        attacks.PGD(Defended(model, Compose(())), **settings),
    ):
        assert not attack(*grey).success.any(), attack


def test_a_rejected_image_is_neither_right_nor_a_success(grey):
    model, settings = Rejecting(bright, red, -9.0), {"eps": 0.5, "steps": 2}
    for attack in (
        attacks.MoireAttack(model, **settings),
        attacks.MoireAttack(model, draws=2, **settings),
        attacks.PGD(model, until_fooled=True, **settings),
        attacks.CW(model, steps=2),
        attacks.MultiTargeted(attacks.PGD(model, **settings)),
    ):
        result = attack(*grey)
        assert not (result.success | result.correct | result.clean_correct).any(), attack
        assert "fooled 0 of 0 right without noise, accuracy 0 to 0 % of 4" in repr(result)
    passed = attacks.PGD(Rejecting(bright, red, 9.0), eps=0.0, steps=1)(*grey)
    assert passed.clean_correct.all() and passed.correct.all()


def test_a_grey_models_rejection_is_no_class():
    def grey(images):
        lead = images.mean((1, 2, 3)) - 0.5
        if images.shape[1] == 3:
            raise ValueError("one channel")
        return torch.stack([-lead, lead], 1)

    rejecting = Rejecting(grey, lambda images: images.mean((1, 2, 3)), 0.5)
    adversarial = AdversarialMoire(rejecting, steps=1)
    with pytest.raises(ValueError, match=r"must lie in \[0, 1\]"):
        adversarial(torch.rand(2, 1, 8, 8), torch.tensor([0, 2]))


def test_an_infinite_score_rejects():
    model = Rejecting(bright, lambda images: images.sum((1, 2, 3)) + torch.inf, 0.5)
    for dtype in (torch.float16, torch.float32, torch.float64):
        logits = model(torch.rand(2, 3, 8, 8).to(dtype))
        assert predicted(logits, rejects=True).tolist() == [attacks.REJECTED] * 2


def test_an_evaluation_tells_rejected_images_from_fooled_ones(grey):
    images, labels = torch.cat([grey[0], grey[0] + 0.1]), torch.cat([grey[1], grey[1]])
    model, settings = Rejecting(bright, red, 0.5), {"eps": 4 / 255, "steps": 1}
    frame = evaluation.evaluate(model, [(images, labels)], **settings, progress=False)
    outcomes = frame[["correct", "rejected", "fooled"]]
    assert (outcomes[~frame["targeted"]].sum(axis=1) == 1).all()
    cells = evaluation.rates(frame).set_index("row")
    assert cells.loc["clean", "rejected"] == 4 and cells.loc["clean", "accuracy"] == 0.5
    assert cells.loc["clean", "counted"] == 4 and (frame["target"].dropna() < 3).all()


def test_rejecting_is_no_class(grey):
    """A label that equals the rejection's column is refused, and a single class beside it."""
    images, labels = grey
    rejecting, settings = Rejecting(bright, red, 0.5), {"eps": 0.1, "steps": 1}
    with pytest.raises(ValueError, match=r"must lie in \[0, 2\]"):
        attacks.PGD(rejecting, **settings)(images, labels + 3)
    with pytest.raises(ValueError, match=r"must lie in \[0, 2\]"):
        evaluation.evaluate(rejecting, [(images, labels + 3)], "unseen", progress=False)
    single = Rejecting(lambda x: bright(x)[:, :1], red, 0.5)
    with pytest.raises(ValueError, match="at least two classes; got 1"):
        attacks.PGD(single, **settings)(images, labels)


def test_mistakes_get_a_sentence():
    for make, message in (
        (lambda: Rejecting(None, red, 0.5), "model must be a function"),
        (lambda: Rejecting(bright, Rejecting, 0.5), "detector must be a function"),
        (lambda: Rejecting(bright, red, float("nan")), "must be a finite number; got nan"),
        (lambda: Rejecting(bright, bright, 0.5)(torch.rand(2, 3, 8, 8)), r"scores \(2,\)"),
        (lambda: Rejecting(bright, vars, 0.5)(torch.rand(2, 3, 8, 8)), "one per image; got dict"),
        (
            lambda: Rejecting(vars, red, 0.5)(torch.rand(2, 3, 8, 8)),
            "tensor of logits .*got a dict",
        ),
    ):
        with pytest.raises((TypeError, ValueError), match=message):
            make()


@pytest.mark.parametrize(("dtype", "excess"), [(torch.float32, 1e-7), (torch.float16, 1e-3)])
@pytest.mark.parametrize("size", [30.0, -30.0, 0.5])
def test_an_excess_that_rounding_loses_rejects_with_its_gradient(dtype, excess, size):
    threshold = 5 * excess
    scores = torch.tensor([threshold + excess, threshold - excess], dtype=dtype, requires_grad=True)
    model = Rejecting(lambda x: torch.full((2, 3), size, dtype=dtype), lambda x: scores, threshold)
    logits = model(torch.rand(2, 3, 8, 8))
    assert (predicted(logits, rejects=True) == attacks.REJECTED).tolist() == [True, False]
    assert torch.autograd.grad(logits[:, -1].sum(), scores)[0].tolist() == [1, 1]


def test_a_rejecting_model_inside_another_is_told_from_one_with_a_class_more(grey):
    rejecting = Rejecting(bright, red, -9.0)
    for model in (
        nn.Sequential(nn.Identity(), rejecting),
        nn.DataParallel(rejecting),
        lambda images: rejecting(images),
    ):
        with pytest.raises(ValueError, match=r"a Rejecting inside .* attribute rejects = True"):
            attacks.PGD(model, steps=1)(*grey)
        with pytest.raises(ValueError, match="a Rejecting inside"):
            evaluation.evaluate(model, [grey], suite="ladder", steps=0, progress=False)
        with pytest.raises(ValueError, match="a Rejecting inside"):
            Defended(model, Compose(()))
        model.rejects = True
        assert not attacks.PGD(model, eps=0.5, steps=1)(*grey).success.any()
        model.rejects = False  # its last logit is that of a class
        assert attacks.PGD(model, eps=0.5, steps=1)(*grey).success.all()
