"""Models that work in place, and another default device: neither changes what an attack finds."""

import pytest
import torch

from tests.attacks.common import attack_by

CASES = {name: 2 for name in ("ma", "pgd", "patch", "cw", "square", "toward pgd")}
CASES["pgd unmoved"] = 0


def found(name, model, batch):
    attack = attack_by(name.removesuffix(" unmoved"), model, CASES[name])
    result = attack(*batch, generator=torch.Generator().manual_seed(0))
    return result.images, result.success, result.noise, result.loss


@pytest.mark.parametrize("name", CASES)
def test_a_model_may_work_in_place(name, model, batch):
    model.eval()
    plain = found(name, lambda x: model(x - 0.5), batch)
    in_place = found(name, lambda x: model(x.sub_(0.5)), batch)
    assert all(map(torch.equal, plain, in_place))


@pytest.mark.parametrize("name", CASES)
def test_another_default_device_changes_nothing(name, model, batch):
    model.eval()
    plain = found(name, model, batch)
    with torch.device("meta"):
        moved = found(name, model, batch)
    assert all(map(torch.equal, plain, moved))
