"""The networks that a model computes with, and the modes that they come back in."""

import functools
import weakref
from unittest import mock

import pytest
import torch
from torch import nn

from moireaug import Scene, attacks, evaluation, transforms
from moireaug.common.networks import device_of, in_evaluation_mode, networks_of
from moireaug.defenses import Defended, Rejecting
from moireaug.defenses.demoire import Demoire

SCENE = Scene()
IMAGES, LABELS = torch.rand(4, 3, 16, 16), torch.arange(4)


class LowRank(nn.Linear):
    """A linear layer that merges a low-rank weight in evaluation, and unmerges it in training."""

    def __init__(self, inputs, outputs):
        super().__init__(inputs, outputs)
        self.weight.requires_grad_(False)
        self.bias.requires_grad_(False)
        self.down = nn.Parameter(torch.randn(2, inputs))
        self.up = nn.Parameter(torch.randn(outputs, 2))
        self.merged = False

    def train(self, mode=True):
        super().train(mode)
        if self.merged == mode:
            sign = -1 if mode else 1
            self.weight.data += sign * (self.up @ self.down)
            self.merged = not mode
        return self

    def forward(self, x):
        y = super().forward(x)
        return y if self.merged else y + x @ self.down.T @ self.up.T


class Observer(nn.Module):
    """Writes into its buffers in evaluation, too, in every way that quantisation's observers,
    queues and counters do; `calls` is a caller's own count."""

    def __init__(self):
        super().__init__()
        self.register_buffer("range", torch.zeros(2))
        self.register_buffer("channels", torch.zeros(0))
        self.register_buffer("queue", torch.zeros(4, 2))
        self.register_buffer("count", torch.tensor(0))
        self.register_buffer("last", None)
        self.is_ready, self.calls = False, 0

    def forward(self, x):
        seen = x.detach()
        self.calls += 1
        if not self.is_ready:
            self.range = torch.stack([seen.min(), seen.max()])  # another tensor
            self.is_ready = True
        self.channels.resize_(x.shape[1]).copy_(seen.amax(0))
        self.queue[:1] = seen[0, :2]
        self.count.data += 1  # behind the version counter
        self.last = seen.mean()
        return x


class Counter(nn.Module):
    """Counts its calls, as those who compare query budgets do."""

    calls = 0

    def forward(self, x):
        self.calls += 1
        return x


def network():
    torch.manual_seed(0)
    layers = (nn.Conv2d(3, 4, 3), nn.BatchNorm2d(4), nn.AdaptiveAvgPool2d(4), nn.Flatten())
    return nn.Sequential(*layers, LowRank(64, 5), Observer())


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
