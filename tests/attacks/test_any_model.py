"""Models that work in place, and another default device: neither changes what an attack finds."""

import pytest
import torch

from moireaug.attacks import CW, PGD, MoireAttack, MultiTargeted, Patch, SquareMoire
from tests.attacks.common import EPS, SCENE

ATTACKS = {
    "ma": lambda m: MoireAttack(m, scene=SCENE, eps=EPS, steps=2),
    "unmoved": lambda m: PGD(m, eps=EPS, steps=0),
    "pgd": lambda m: PGD(m, eps=EPS, steps=2),
    "patch": lambda m: Patch(m, area=0.1, steps=2),
    "cw": lambda m: CW(m, steps=2),
    "square": lambda m: SquareMoire(m, scene=SCENE, eps=EPS, steps=2),
    "targeted": lambda m: MultiTargeted(PGD(m, steps=1), targets=1),
}


def found(name, model, batch):
    result = ATTACKS[name](model)(*batch, generator=torch.Generator().manual_seed(0))
    return result.images, result.success, result.noise, result.loss


@pytest.mark.parametrize("name", ATTACKS)
def test_a_model_may_work_in_place(name, model, batch):
    model.eval()
    plain = found(name, lambda x: model(x - 0.5), batch)
    in_place = found(name, lambda x: model(x.sub_(0.5)), batch)
    assert all(map(torch.equal, plain, in_place))


@pytest.mark.parametrize("name", ATTACKS)
def test_another_default_device_changes_nothing(name, model, batch):
    model.eval()
    plain = found(name, model, batch)
    with torch.device("meta"):
        moved = found(name, model, batch)
    assert all(map(torch.equal, plain, moved))
