"""APGD by the cross-entropy, then APGD-T on what is left, and on nothing else."""

import dataclasses

import pytest
import torch

from moireaug import Scene
from moireaug.attacks import MoireAttack, MultiTargeted
from moireaug.defenses import BitDepth
from moireaug.evaluation.autoattack import APGDAttacker, APGDTAttacker
from moireaug.evaluation.classifiers import Classifier
from moireaug.evaluation.conditions import EvalBatch
from tests.attacks.common import counting

SCENE = Scene.preset("screen_photo")
EPS = 2 / 255
SETTINGS = {"eps": EPS, "steps": 3}


@pytest.fixture(scope="module")
def batch(known):
    model, ((images, labels), _) = known
    shot = SCENE.sample(8, (16, 16), torch.Generator().manual_seed(1))
    generator = torch.Generator().manual_seed(0)
    return EvalBatch(model, images, labels, (labels + 1) % 4, shot, generator)


def test_apgd_t_attacks_what_the_cross_entropy_leaves(batch):
    settings = SETTINGS | {"scene": SCENE, "rule": "apgd", "until_fooled": True}
    first = MoireAttack(batch.model, **settings)(batch.images, batch.labels, shot=batch.shot)
    right = (~first.success).nonzero()[:, 0]
    assert 0 < len(right) < 8, "or the test says nothing"
    images = APGDAttacker(**SETTINGS).show(batch)
    assert torch.equal(images[first.success], first.images[first.success])
    toward = MultiTargeted(MoireAttack(batch.model, loss="dlr", **settings))
    rest = toward(batch.images[right], batch.labels[right], shot=batch.shot[right])
    assert torch.equal(images[right], rest.images)
    assert torch.equal(images[right], APGDTAttacker(**SETTINGS).show(batch[right]))


def test_images_that_are_all_fooled_are_not_attacked_again(batch):
    """Nor does a wrong one take a step: two looks, whether the model answers the same, the photo
    that is kept, and the images twice, for the same question."""
    model, asked = counting(batch.model)
    wrong = dataclasses.replace(batch, model=model, labels=batch.targets)
    images = APGDAttacker(**SETTINGS).show(wrong)
    assert images.shape == batch.images.shape and asked == [8] * 5


def test_a_model_that_answers_at_random_keeps_the_greater_margin(batch, monkeypatch):
    """The second attack's noise in even rows, the cross-entropy's in odd ones, where the second's
    is no better. As in AutoAttack's version "rand", no class is a target."""

    def model(images):
        lead = 10 * images.mean((1, 2, 3)) + 0.1 * torch.rand(len(images))
        return torch.stack([0 * lead, lead], 1)

    even = (torch.arange(8) % 2 == 0)[:, None, None, None]
    extremes = even * torch.ones_like(batch.images)
    losses, result_of = [], APGDAttacker.result_of

    def recorded(attacker, attack, batch):
        losses.append(attack.loss)
        result = result_of(attacker, attack, batch)
        return result if attack.loss == "ce" else dataclasses.replace(result, images=extremes)

    monkeypatch.setattr(APGDAttacker, "result_of", recorded)
    random = dataclasses.replace(batch, model=model, labels=torch.zeros_like(batch.labels))
    images = APGDAttacker(**SETTINGS).show(random)
    assert losses == ["ce", "margin"]  # of two classes, which have no DLR loss
    assert torch.equal(images[::2], extremes[::2]) and (images[1::2].mean((1, 2, 3)) > 0).all()


def test_an_attack_through_a_defence_is_another_one(batch):
    coarse = Classifier("coarse", defence=BitDepth(1))
    through, plain = APGDAttacker(**SETTINGS, known_classifier=coarse), APGDAttacker(**SETTINGS)
    assert through.name == "apgd_2_through_coarse" and plain.name == "apgd_2"
    assert through.settings()["known_judge"] == coarse.identity != plain.settings()["known_judge"]
    assert not torch.equal(through.show(batch), plain.show(batch))


@pytest.mark.parametrize("attacker", [APGDAttacker, APGDTAttacker])
def test_an_attack_toward_several_classes_has_no_target(attacker):
    """Its success would be counted as that of reaching a class that it never goes toward."""
    with pytest.raises(ValueError, match=f"{attacker.__name__} goes toward .*MoireAttacker"):
        attacker(**SETTINGS, targeted=True)
