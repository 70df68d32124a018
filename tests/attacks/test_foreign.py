"""What users of other attack libraries type is answered with what stands for it here."""

import copy
import dataclasses
import pickle

import pytest
import torch
from torch import nn

from moireaug import attacks
from moireaug.attacks import BIM, CW, PGD, MoireAttack, MultiTargeted, SquareMoire
from moireaug.attacks.base import ARGUMENT_ADVICE, ATTACK_ADVICE

MODEL = nn.Sequential(nn.Flatten(), nn.Linear(768, 5))
ARGUMENTS = [
    (PGD, {"alpha": 2 / 255}, "has no argument 'alpha': pass step_size=, in units of eps"),
    (MoireAttack, {"targeted": True}, "pass targets to the call"),
    (CW, {"kappa": 1}, "pass confidence="),
    (SquareMoire, {"n_queries": 50}, "pass steps="),
]


@pytest.mark.parametrize(("attack", "settings", "sentence"), ARGUMENTS)
def test_an_argument_of_another_library_names_ours(attack, settings, sentence):
    with pytest.raises(TypeError, match=sentence):
        attack(MODEL, **settings)
    with pytest.raises(TypeError, match="unexpected keyword argument 'alphas'"):
        attack(MODEL, alphas=1)


def test_settings_without_names_are_answered_with_how_to_write_them():
    for attack, says in (
        (PGD, r"PGD takes .* by name, as PGD\(model, eps=8/255\); got 0\.5 without one"),
        (SquareMoire, r"SquareMoire\(model, eps=8/255\)"),
        (CW, r"CW\(model, c=1\)"),
    ):
        with pytest.raises(TypeError, match=says):
            attack(MODEL, 0.5, 2 / 255, 10)
    with pytest.raises(TypeError, match=r"MultiTargeted\(attack, targets=9\); got 4"):
        MultiTargeted(PGD(MODEL), 4)


def test_an_attack_toward_several_classes_takes_no_targets():
    images, labels = torch.rand(4, 3, 16, 16), torch.arange(4)
    with pytest.raises(ValueError, match="MultiTargeted chooses its own targets"):
        MultiTargeted(PGD(MODEL))(images, labels, labels + 1)


def test_no_advice_is_about_an_argument_of_ours():
    for attack in attacks.ATTACKS.values():
        assert ARGUMENT_ADVICE.keys().isdisjoint(attack.__dataclass_fields__)


def test_an_attack_of_another_library_names_ours():
    for name, advice in ATTACK_ADVICE.items():
        with pytest.raises(AttributeError, match=f"has no attribute '{name}'") as refused:
            getattr(attacks, name)
        assert advice in str(refused.value)
    with pytest.raises(AttributeError, match=r"has no attribute 'Nothing'\.$"):
        attacks.Nothing  # noqa: B018


def test_what_is_advised_for_fgsm_is_fgsm():
    images, labels = torch.rand(4, 3, 16, 16), torch.arange(4)
    x = images.clone().requires_grad_()
    nn.functional.cross_entropy(MODEL(x), labels).backward()
    found = BIM(MODEL, steps=1, eps=4 / 255)(images, labels).images
    torch.testing.assert_close(found, (images + 4 / 255 * x.grad.sign()).clamp(0, 1))


def test_an_attack_prints_its_settings_without_the_network():
    for attack in (PGD(MODEL), CW(MODEL), MultiTargeted(PGD(MODEL)), MoireAttack(MODEL)):
        assert "Linear" not in repr(attack) and "steps=" in repr(attack)
        assert pickle.loads(pickle.dumps(attack)) is not None
        assert repr(copy.deepcopy(attack)) == repr(attack)
    assert dataclasses.replace(PGD(MODEL), steps=3).steps == 3
