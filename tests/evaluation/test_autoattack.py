"""APGD by the cross-entropy, then APGD-T on what is left: never weaker than its first part, and no
image is attacked twice without need."""

import dataclasses

import pytest
import torch

from moireaug import Scene
from moireaug.attacks import MoireAttack, MultiTargeted
from moireaug.defenses import BitDepth
from moireaug.evaluation.autoattack import Apgd, TargetedApgd
from moireaug.evaluation.conditions import EvalBatch
from moireaug.evaluation.judges import Judge

SCENE = Scene.preset("screen_photo")
EPS = 2 / 255


@pytest.fixture(scope="module")
def batch(known):
    model, ((images, labels), _) = known
    shot = SCENE.sample(8, (16, 16), torch.Generator().manual_seed(1))
    generator = torch.Generator().manual_seed(0)
    return EvalBatch(model, images, labels, (labels + 1) % 4, shot, generator)


@pytest.fixture(scope="module")
def first(batch):
    attack = MoireAttack(batch.model, scene=SCENE, eps=EPS, steps=3, rule="apgd", until_fooled=True)
    return attack(batch.images, batch.labels, shot=batch.shot)


def test_what_the_cross_entropy_fools_stays_and_the_rest_is_attacked_by_apgd_t(batch, first):
    """Some of both, or the test says nothing."""
    right = (~first.success).nonzero()[:, 0]
    assert 0 < len(right) < 8
    shown = Apgd(eps=EPS, steps=3).perturb(batch)
    assert torch.equal(shown[first.success], first.images[first.success])
    toward = MultiTargeted(
        MoireAttack(
            batch.model,
            scene=SCENE,
            eps=EPS,
            steps=3,
            rule="apgd",
            loss="dlr",
            until_fooled=True,
        )
    )
    rest = toward(batch.images[right], batch.labels[right], shot=batch.shot[right])
    assert torch.equal(shown[right], rest.images)
    assert torch.equal(shown[right], TargetedApgd(eps=EPS, steps=3).perturb(batch[right]))


def test_the_worst_is_no_better_than_either(batch, first):
    fooled = first.success
    with torch.no_grad():
        found = batch.model(Apgd(eps=EPS, steps=3, classes=1).perturb(batch)).argmax(1)
        every = batch.model(Apgd(eps=EPS, steps=3).perturb(batch)).argmax(1)
    one, three = found != batch.labels, every != batch.labels
    assert one[fooled].all() and three[one].all()


def test_images_that_are_all_fooled_are_not_attacked_again(batch):
    """Nor does one that is wrong take a step: it is looked at twice, to see that the model answers
    the same, and then the photo that is kept."""
    asked = []

    def model(images):
        asked.append(len(images))
        return batch.model(images)

    wrong = dataclasses.replace(batch, model=model, labels=batch.targets)
    shown = Apgd(eps=EPS, steps=3).perturb(wrong)
    assert shown.shape == batch.images.shape and asked == [8] * 3


def test_an_attack_through_a_defence_is_another_one(batch):
    coarse = Judge("coarse", defence=BitDepth(1))
    through, plain = (Apgd(eps=EPS, steps=2, knows=knows) for knows in (coarse, None))
    assert through.name == "apgd_2_through_coarse" and plain.name == "apgd_2"
    assert through.settings()["knows"] == coarse.identity
    assert plain.settings()["knows"] is None
    assert not torch.equal(through.perturb(batch), plain.perturb(batch))
