"""The networks that a model computes with are found, put into evaluation mode, and put back."""

import functools
import weakref
from unittest import mock

import pytest
import torch
from torch import nn

from moireaug import attacks
from moireaug.common.networks import device_of, in_evaluation_mode, networks_of
from moireaug.defenses import Defended, Rejecting
from moireaug.defenses.demoire import Demoire
from tests.odd_networks import network

IMAGES, LABELS = torch.rand(4, 3, 16, 16), torch.arange(4)


class Owner:
    def __init__(self, net):
        self.net = net

    def logits(self, x):
        return self.net(x)


class Called(Owner):
    __call__ = Owner.logits


class Listed(nn.Module):
    """Has a network that is not its submodule."""

    def __init__(self, net):
        super().__init__()
        self.nets = [net]

    def forward(self, x):
        return self.nets[0](x)


GLOBAL = nn.Sequential(nn.AdaptiveAvgPool2d(4), nn.Flatten(), nn.Linear(48, 5))


def by_name(x):
    return GLOBAL(x)


@torch.no_grad()
def decorated(x):
    return GLOBAL(x)


def by_another_function(x):
    return by_name(x)


CALLABLES = {
    "module": lambda net: net,
    "forward": lambda net: net.forward,
    "partial": functools.partial,
    "lambda": lambda net: lambda x: net(x),
    "method": lambda net: Owner(net).logits,
    "object": Called,
    "default": lambda net: lambda x, nets=(net,): nets[0](x),
    "keyword-only default": lambda net: lambda x, *, own=net: own(x),
    "list in a module": Listed,
    "defended lambda": lambda net: Defended(lambda x: net(x), lambda x: x),
}


def test_a_network_that_a_function_names_is_found():
    assert networks_of(by_name) == networks_of(decorated) == [GLOBAL]
    assert networks_of(lambda x: x.mean((2, 3))) == []


def test_what_is_not_followed_keeps_its_mode():
    net, looked_up = network(), {}

    class Registry:  # no callable: nothing tells that its network is used
        def __init__(self):
            self.net = net

    registry = Registry()
    with in_evaluation_mode(lambda x: registry.net(x)):
        assert net.training
    with in_evaluation_mode(lambda x: looked_up["net"](x)):
        assert net.training
    assert networks_of(by_another_function) == []


@pytest.mark.parametrize("kind", CALLABLES)
def test_statistics_stay_behind_any_callable(kind):
    net = network().train()
    attacks.PGD(CALLABLES[kind](net), steps=2)(IMAGES, LABELS)
    assert net[1].num_batches_tracked == 0 and all(m.training for m in net.modules())
    with torch.no_grad():  # negative control: in training they move
        net(IMAGES)
    assert net[1].num_batches_tracked == 1


def test_a_merged_layer_in_evaluation_stays_merged_after_an_error():
    net = network()
    net[4].eval()
    with pytest.raises(KeyError), in_evaluation_mode(net):
        assert not net.training and net[4].merged
        raise KeyError
    assert net.training and net[1].training and not net[4].training and net[4].merged


def test_an_exported_graph_is_attacked_as_it_is():
    net = nn.Sequential(nn.AdaptiveAvgPool2d(4), nn.Flatten(), nn.Linear(48, 5)).eval()
    graph = torch.export.export(net, (IMAGES,)).module()
    with pytest.raises(NotImplementedError):
        graph.eval()
    losses = []
    for model in (net, graph):
        generator = torch.Generator().manual_seed(0)
        losses.append(attacks.PGD(model, steps=2)(IMAGES, LABELS, generator=generator).loss)
    torch.testing.assert_close(*losses)


class Refusing(nn.Sequential):
    """Takes neither mode, as an engine that runs elsewhere."""

    eval = None

    def train(self, mode=True):
        raise RuntimeError("an engine has no mode")


def test_a_module_without_modes_is_attacked_as_it_is():
    net = network().train()
    model = Refusing(net)
    attacks.PGD(model, steps=2)(IMAGES, LABELS)
    assert net[1].num_batches_tracked == 0  # its network has modes
    assert all(module.training for module in model.modules()) and not net[4].merged


def test_a_demoireing_network_keeps_its_mode():
    net = nn.Sequential(nn.Conv2d(3, 3, 1), nn.BatchNorm2d(3)).train()
    defended = Defended(lambda x: x.mean((2, 3)), Demoire(net))
    assert net.training
    attacks.PGD(defended, steps=2)(IMAGES, LABELS % 3)
    assert net.training and net[1].num_batches_tracked == 0


def test_a_frozen_child_of_several_parents_stays_frozen():
    shared = nn.BatchNorm2d(3)
    net = nn.Sequential(nn.Sequential(shared, nn.Conv2d(3, 3, 1)), nn.Sequential(shared)).train()
    shared.eval()
    stem, head = nn.BatchNorm2d(3).eval(), nn.Conv2d(3, 3, 1)
    whole = nn.Sequential(stem, head)
    models = [net, lambda x: head(stem(x)).mean((2, 3)) + whole(x).mean((2, 3))]
    before = [m.training for part in (net, whole) for m in part.modules()]
    for model in models:
        with in_evaluation_mode(model):
            pass
    assert [m.training for part in (net, whole) for m in part.modules()] == before


@pytest.mark.parametrize("first_out", [0, 1])
def test_of_overlapping_blocks_the_last_one_restores(first_out):
    net = network().train()
    blocks = [in_evaluation_mode(net), in_evaluation_mode(net[4])]
    for block in blocks:
        block.__enter__()
    blocks[first_out].__exit__(None, None, None)
    assert not net[4].training and net[4].merged
    blocks[1 - first_out].__exit__(None, None, None)
    assert all(module.training for module in net.modules()) and not net[4].merged


def test_what_raises_when_it_is_looked_at_is_passed_over():
    class Odd(nn.Module):
        def __init__(self):
            super().__init__()
            self.net = GLOBAL
            owner = Owner(None)
            self.gone = weakref.proxy(owner)  # whose owner ends here

    assert len(networks_of(Odd())) == 1
    assert networks_of(mock.Mock(spec=nn.Module)) == []
    assert networks_of(lambda x, data=[GLOBAL] * 1001: x) == []


def test_a_device_is_known_by_weights_or_buffers():
    assert device_of(nn.BatchNorm2d(3, affine=False, device="meta")) == torch.device("meta")
    assert device_of(nn.Linear(1, 1)) == torch.device("cpu") and device_of(nn.ReLU()) is None


def test_the_device_of_a_wrapper_is_that_of_its_network():
    net = nn.Linear(1, 1, device="meta")
    for call in (net, lambda x: net(x)):
        for wrapped in (attacks.Normalized(call), Rejecting(call, torch.sum, 0.5)):
            assert device_of(wrapped) == torch.device("meta")
    assert device_of(attacks.Normalized(lambda x: x)) is None
    assert device_of(nn.Sequential(Rejecting(torch.sum, torch.sum, 0.5))) is None
