"""Keys of records: what they mean changes them, and nothing else does."""

import dataclasses

import pytest
import torch
from torch import nn

from moireaug import Scene
from moireaug.attacks import Normalized
from moireaug.defenses import JPEG, Compose
from moireaug.evaluation.attackers import MoireAttacker
from moireaug.evaluation.judges import UNDEFENDED, Judge, digest, identity
from moireaug.evaluation.records import Records
from moireaug.evaluation.runner import Runner
from tests.evaluation.haze import CONDITIONS, EPS, SCENE, ran

from .conftest import classifier

CHANGES = {
    "steps": 3,
    "eps": EPS / 2,
    "restarts": 2,
    "targeted": True,
    "rule": "apgd",
    "loss": "margin",
    "noise_at": "photo",
    "optimise": ("noise", "view"),
    "until_fooled": False,
    "knows": Judge("j", defence=JPEG(60)),
    "variant": "other",
    "scene": Scene.preset("paper"),
}


@pytest.mark.parametrize("setting", CHANGES)
def test_a_key_changes_with_every_setting(known, setting):
    runner = ran(known)
    plain = CONDITIONS["ma"]
    assert runner.key(plain, UNDEFENDED, 0) in runner.records
    changed = dataclasses.replace(plain, **{setting: CHANGES[setting]})
    assert runner.key(changed, UNDEFENDED, 0) not in runner.records
    assert runner.key(plain, Judge("other"), 0) not in runner.records


def test_every_setting_of_an_attacker_is_tried():
    named = {field.name for field in dataclasses.fields(MoireAttacker)}
    assert named - {"place"} == set(CHANGES)


def test_a_defence_is_known_by_its_settings_and_weights():
    """Not by its name alone."""
    parts = [
        JPEG(60),
        JPEG(10),
        Compose((JPEG(60),)),
        Compose((classifier(0),)),
        Compose((classifier(1),)),
        classifier(0),
        torch.nn.functional.relu,
        torch.nn.functional.gelu,
        lambda x: x,
        lambda x: x + 1,
    ]
    found = [identity(part) for part in parts]
    assert len(set(found)) == len(parts)
    assert found[:5] == [identity(part) for part in parts[:5]]
    keys = {Judge("one", defence=part).identity for part in parts}
    assert len(keys) == len(parts)
    knowing = [
        MoireAttacker(eps=EPS, steps=2, knows=Judge("j", defence=part)) for part in parts[:2]
    ]
    assert knowing[0].settings() != knowing[1].settings()


def test_a_digest_sees_buffers_that_are_not_saved_and_layers_without_weights():
    net = classifier()
    grey, plain = Normalized(net, (0.5,) * 3, (0.5,) * 3), Normalized(net, (0.0,) * 3, (1.0,) * 3)
    assert digest(grey) != digest(plain)
    assert digest(nn.Sequential(net, nn.ReLU())) != digest(nn.Sequential(net, nn.GELU()))
    assert digest(classifier(0)) == digest(classifier(0)) != digest(classifier(1))


def test_a_key_changes_with_weights_scene_and_pixels(known):
    model, batches = known
    runner = ran(known)
    plain = CONDITIONS["ma"]
    key = runner.key(plain, UNDEFENDED, 0)
    assert Runner(model, batches, SCENE, Records(), seed=3).key(plain, UNDEFENDED, 0) == key
    for other in (
        Runner(classifier(1), batches, SCENE, Records(), seed=3),
        Runner(model, batches, Scene.preset("phone_at_laptop"), Records(), seed=3),
        Runner(model, [(x * 0.5, y) for x, y in batches], SCENE, Records(), seed=3),
        Runner(model, [(x, (y + 1) % 4) for x, y in batches], SCENE, Records(), seed=3),
    ):
        assert other.key(plain, UNDEFENDED, 0) != key
