"""Models without a valid answer: every attack says so, and no answer counts as a wrong one."""

import math
import re
from collections import namedtuple

import numpy as np
import pytest
import torch
from torch import nn

from moireaug import Scene, Sensor, attacks, capture
from moireaug.attacks import CW, PGD, MoireAttack, MultiTargeted, SquareMoire
from moireaug.transforms import AdversarialMoire
from tests.attacks.common import EPS, SCENE, attack_by, predicted, refusal

ATTACKS = ("ma", "ma apgd", "ma eot", "ma turned", "pgd", "bim", "mifgsm", "cw", "square")
ADVERSARIES = (*ATTACKS, "transform")
Outputs = namedtuple("Outputs", "logits aux")


def adversary_by(name, model, steps=2):
    if name == "transform":
        return AdversarialMoire(model, scene=SCENE, eps=EPS, steps=steps)
    return attack_by(name, model, steps)


NO_LOGITS = [
    (lambda z: {"loss": z.sum(), "logits": z}, "dict of 'loss', 'logits'.", "(images)['logits']"),
    (lambda z: {"out": z}, "got a dict of 'out'.", "model(images)['out']"),
    (lambda z: (z, z), "got a tuple of 2.", "model(images)[0]"),
    (lambda z: [z], "got a list of 1.", "model(images)[0]"),
    (lambda z: Outputs(z, None), "got a Outputs of 2.", "model(images)[0]"),
    (lambda z: z.detach().numpy(), "got a ndarray.", ""),
    (lambda z: None, "got a NoneType.", ""),
]


def test_what_is_no_tensor_is_named_with_its_wrapper(model, batch):
    cases = [("ma", *case) for case in NO_LOGITS]
    cases += [(name, *NO_LOGITS[0]) for name in ADVERSARIES[1:]]
    for name, change, got, wrap in cases:
        said = refusal(adversary_by(name, lambda x, change=change: change(model(x))), *batch)
        assert "the model must return a tensor of logits (B, K)" in said, name
        assert got in said and wrap in said, name


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_model_without_any_answer_is_refused(bad, model, batch):
    cases = (
        [(name, 2) for name in ADVERSARIES]
        + [(name, 0) for name in ("ma", "pgd", "cw")]
        + [("toward pgd", 1)]
    )
    for name, steps in cases:
        said = refusal(adversary_by(name, lambda x: model(x) + bad, steps), *batch)
        assert "for all 6 clean images: it is broken, not robust" in said, (name, steps)


def test_targets_that_are_labels_are_refused(model, batch):
    images, labels = batch
    targets = (labels + 1) % 5
    targets[4] = labels[4]
    for name in ATTACKS:
        with pytest.raises(ValueError, match=r"must be other classes.*1 of 6 .*image 4.*Leave"):
            attack_by(name, model)(images, labels, targets)


@pytest.mark.parametrize("cut", ["its output", "its input"])  # where the weights keep a gradient
def test_a_model_that_cuts_the_gradient_off_is_refused(cut, model, batch):
    """A camera that turns does not hide it."""
    output = cut == "its output"
    for name in (*ADVERSARIES, "ma pose"):
        if name != "square":
            attack = adversary_by(
                name, lambda x: model(x).detach() if output else model(x.detach())
            )
            with pytest.raises(ValueError, match=r"logits have no gradient.*attacks\.SquareMoire"):
                attack(*batch)


def broken_on(rows, model):
    """Answers NaN to these rows of a batch; the others' gradients stay whole."""

    def answer(x):
        spoilt = torch.zeros(len(x), 1)
        spoilt.view(-1, 6, 1)[:, rows] = math.nan
        return model(x) + spoilt

    return answer


@pytest.mark.parametrize("targeted", [False, True])
@pytest.mark.parametrize("name", ATTACKS)
def test_an_image_without_answer_is_fooled_never_at_its_target(name, targeted, model, batch):
    images = batch[0][..., :8, :8]
    model.eval()
    labels = torch.zeros(6, dtype=torch.long)  # what argmax of NaN returns
    targets = torch.full((6,), 1) if targeted else None
    whole, result = (
        attack_by(name, one, 1)(images, labels, targets, generator=torch.Generator())
        for one in (model, broken_on([1, 2], model))
    )
    assert result.success[[1, 2]].tolist() == [not targeted] * 2
    others = [0, 3, 4, 5]
    assert torch.equal(result.success[others], whole.success[others])
    assert torch.equal(result.images[others], whole.images[others])
    assert result.images.isfinite().all() and result.noise.isfinite().all()


def nan_when_shown_noise(clean):
    """Right about the clean images with a margin that no noise crosses; NaN for anything else."""

    def answer(x):
        sure = torch.tensor([9.0, 0.0]).expand(len(x), 2) + 0 * x.sum((1, 2, 3))[:, None]
        off = (x - clean).abs().amax((1, 2, 3)) > 1e-3
        return torch.where(off[:, None], sure * math.nan, sure)

    return answer


def test_a_model_that_hides_behind_nan_is_fooled(batch):
    images = batch[0] * 0.5 + 0.2
    model = nan_when_shown_noise(images)
    settings = {"eps": EPS, "steps": 3}
    plain = settings | {"scene": Scene(sensor=Sensor(cfa="none", exposure="mean", gain=3.0))}
    for attack in (
        PGD(model, **settings),
        # which answers otherwise when it is asked again
        MultiTargeted(PGD(lambda x: model(x) * (1 + torch.rand(())), **settings)),
        MoireAttack(model, random_start=1.0, **plain),
        SquareMoire(model, **plain),
    ):
        assert attack(images, torch.zeros(6, dtype=torch.long)).success.all(), attack


def test_a_prediction_is_of_a_finite_greatest_logit():
    for logits, expected in (
        ([0.0, 2.0, 1.0], 1),
        ([math.nan, 2.0, 1.0], -1),
        ([0.0, math.nan, 9.0], -1),
        ([0.0, math.inf, 9.0], -1),
        ([-math.inf, 2.0, 1.0], 1),
        ([-math.inf] * 3, -1),
    ):
        assert attacks.predicted(torch.tensor([logits])).tolist() == [expected], logits


def test_a_result_prints_as_one_line(model, batch):
    result = MoireAttack(model, scene=SCENE, eps=EPS, steps=2)(*batch)
    number = r"[\d.]+"
    losses = f"loss {number} to {number} in 2 steps"
    counts = rf"fooled \d of \d right without noise, accuracy {number} to {number} % of 6"
    assert re.fullmatch(rf"Result\(eps 4/255 in codes, {counts}, {losses}\)", str(result))
    assert str(PGD(model, steps=0)(*batch)).endswith(" % of 6)")
    assert str(PGD(model, steps=1)(*batch)).endswith(" in 1 step)")
    none = (batch[0][:0], batch[1][:0])
    assert (
        str(PGD(model, steps=1)(*none))
        == "Result(eps 4/255 in codes, fooled 0 of 0 right without noise)"
    )


class Darkness(nn.Module):
    """Sees class 1 in images whose mean is below a threshold, class 0 in others."""

    def __init__(self, threshold):
        super().__init__()
        self.threshold = threshold

    def forward(self, x):
        return torch.stack([x.mean((1, 2, 3)) - self.threshold, torch.zeros(len(x))], 1)


@pytest.mark.parametrize("attack", [PGD, CW, SquareMoire, MultiTargeted], ids=lambda a: a.__name__)
def test_a_result_counts_as_fooled_what_was_right_without_noise(attack):
    """Of four images, one is far from the threshold, two lie near it and one is wrong already."""
    images = torch.tensor([0.9, 0.501, 0.501, 0.2])[:, None, None, None].expand(4, 3, 8, 8)
    labels, model = torch.tensor([0, 0, 0, 0]), Darkness(0.5)
    if attack is SquareMoire:
        found = SquareMoire(model, scene=Scene(), steps=2, noise_at="photo")(images, labels)
        before = Darkness(0.5)(capture(images, found.shot)).argmax(1) == labels
    else:
        kinds = {PGD: PGD(model), CW: CW(model), MultiTargeted: MultiTargeted(PGD(model))}
        found, before = kinds[attack](images, labels), torch.tensor([True, True, True, False])
    assert torch.equal(found.clean_correct, before) and not found.correct[3]
    right, fooled = int(before.sum()), int((before & found.success).sum())
    after = int(found.correct.sum())
    assert f"fooled {fooled} of {right} right without noise" in repr(found) and found.success[3]
    assert f"accuracy {25 * right} to {25 * after} % of 4" in repr(found)
    if attack is not SquareMoire:
        assert (fooled, right, after) == (2, 3, 1)


def test_a_targeted_result_keeps_two_counts(model, batch):
    images, labels = batch
    found = PGD(model, steps=3)(images, labels, (labels + 1) % 5)
    answers = predicted(model, found.images)
    assert torch.equal(found.correct, answers == labels)
    assert torch.equal(found.success, answers == (labels + 1) % 5)


@pytest.mark.parametrize("restarts", [1, 2])
def test_one_image_without_answer_ends_no_restarts_of_others(restarts):
    torch.manual_seed(0)
    net = nn.Sequential(nn.AdaptiveAvgPool2d(8), nn.Flatten(), nn.Linear(192, 10))

    def model(x):
        return torch.where((x.mean((1, 2, 3)) < 0.3)[:, None], float("nan"), net(x))

    images, labels = torch.rand(4, 3, 32, 32), torch.arange(4)
    images[1] = 0
    attack = PGD(model, eps=np.float32(0.2), steps=40, restarts=restarts, until_fooled=True)
    found = attack(images, labels, (labels + 1) % 10)
    assert found.success.tolist() == [True, False, True, True]
