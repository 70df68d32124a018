"""A network that an attack or an evaluation has used comes back as it was."""

import pytest
import torch
from torch import nn

from moireaug import Scene, attacks, evaluation, transforms
from moireaug.common.networks import in_evaluation_mode
from moireaug.defenses import Defended
from tests.odd_networks import Counter, network

SCENE = Scene()
IMAGES, LABELS = torch.rand(4, 3, 16, 16), torch.arange(4)


def evaluated(model):
    settings = {"suite": "trust", "steps": 1, "progress": False}
    return lambda images, labels: evaluation.evaluate(model, [(images, labels)], **settings)


BORROWERS = {
    "pgd": lambda model: attacks.PGD(model, steps=2),
    "cw": lambda model: attacks.CW(model, steps=2),
    "ma": lambda model: attacks.MoireAttack(model, scene=SCENE, steps=2),
    "multitargeted": lambda model: attacks.MultiTargeted(attacks.PGD(model, steps=1), targets=1),
    "transform": lambda model: transforms.AdversarialMoire(model, SCENE, steps=1),
    "evaluate": evaluated,
    "defended": lambda model: attacks.PGD(Defended(model, lambda x: x), steps=1),
}


@pytest.mark.parametrize("borrower", BORROWERS)
def test_a_borrowed_network_comes_back_as_it_was(borrower):
    net = network().train()
    net[1].eval()  # as where statistics are frozen
    weight, before = net[4].weight.clone(), {k: v.clone() for k, v in net.state_dict().items()}
    buffers = dict(net.named_buffers())
    BORROWERS[borrower](net)(IMAGES, LABELS)
    assert [m.training for m in net.modules()] == [True, True, False, True, True, True, True]
    assert not net[4].merged
    torch.testing.assert_close(net[4].weight, weight)
    del before["4.weight"]
    assert net.state_dict().keys() - {"4.weight"} == before.keys()
    assert all(buffers[name] is buffer for name, buffer in net.named_buffers())
    assert (net[5].is_ready, net[5].calls, net[5].last) == (False, 0, None)
    assert all(torch.equal(net.state_dict()[name], value) for name, value in before.items())
    assert net(IMAGES).requires_grad


def test_what_a_forward_pass_writes_stays_without_a_block():
    """Negative control of the test above; and a count that goes with no buffer is a caller's."""
    net, counter = network(), Counter()
    net(IMAGES)
    assert net[5].count == 1 and net[5].is_ready and net[5].channels.shape == (5,)
    attacks.PGD(nn.Sequential(network(), counter), steps=2)(IMAGES, LABELS)
    assert counter.calls


def test_an_unchanged_buffer_is_not_written():
    """A graph that has kept it would no longer go backward."""
    net = network()
    net[5].eval()
    version = net[5].queue._version
    with in_evaluation_mode(net):
        net[5].count += 1
    assert (net[5].count, net[5].queue._version) == (0, version)


def test_buffers_of_an_inference_are_put_back():
    with torch.inference_mode():
        net = network()
        before = net[5].queue.clone()
    with in_evaluation_mode(net), torch.inference_mode():
        net(IMAGES)
        assert not torch.equal(net[5].queue, before)
    assert torch.equal(net[5].queue, before) and net[5].queue.is_inference()


def test_weights_that_a_forward_pass_writes_are_told():
    net = network()
    warning = pytest.warns(UserWarning, match=r"weights changed .*Conv2d\.bias.*are not put back")
    with warning, in_evaluation_mode(net), torch.no_grad():
        net[0].bias += 1
    assert all(module.training for module in net.modules())
