"""Models that work in place, and another default device: neither changes what an attack finds."""

import pytest
import torch

from tests.attacks.common import attack_by

CASES = {name: 2 for name in ("ma", "pgd", "patch", "cw", "square", "toward pgd")}
CASES["pgd unmoved"] = 0


@pytest.mark.parametrize("name", CASES)
def test_a_model_may_work_in_place_beside_any_default_device(name, model, batch):
    model.eval()

    def found(model):
        attack = attack_by(name.removesuffix(" unmoved"), model, CASES[name])
        result = attack(*batch, generator=torch.Generator().manual_seed(0))
        return result.images, result.success, result.noise, result.loss

    plain = found(lambda x: model(x - 0.5))
    assert all(map(torch.equal, plain, found(lambda x: model(x.sub_(0.5)))))
    with torch.device("meta"):
        assert all(map(torch.equal, plain, found(lambda x: model(x - 0.5))))
