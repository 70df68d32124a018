"""Muon: orthogonal steps against the singular value decomposition, SGD's against torch's own."""

import copy

import pytest
import torch
from torch import nn

from training.classifier.muon import CUBIC, ITERATIONS, LINEAR, QUINTIC, SGD_LR, Muon, orthogonal

SHAPES = [(1, 9), (8, 8), (16, 144), (144, 16), (128, 1152)]


def matrix(shape, smallest=0.05, dtype=torch.float64):
    """A matrix of known singular vectors and of singular values from `smallest` to 1."""
    g = torch.Generator().manual_seed(0)
    rank = min(shape)
    left, _ = torch.linalg.qr(torch.randn(shape[0], rank, generator=g, dtype=torch.float64))
    right, _ = torch.linalg.qr(torch.randn(shape[1], rank, generator=g, dtype=torch.float64))
    values = torch.logspace(0, torch.tensor(smallest).log10(), rank, dtype=torch.float64)
    return (left @ values.diag() @ right.mT).to(dtype), left @ right.mT


@pytest.mark.parametrize("shape", SHAPES)
def test_it_is_the_polynomial_of_the_singular_values(shape):
    given, _ = matrix(shape)
    left, values, right = torch.linalg.svd(given, full_matrices=False)
    values = values / values.norm()
    for _ in range(ITERATIONS):
        values = LINEAR * values + CUBIC * values**3 + QUINTIC * values**5
    tall = max(1.0, shape[0] / shape[1]) ** 0.5
    torch.testing.assert_close(orthogonal(given), tall * left @ values.diag() @ right)


@pytest.mark.parametrize("shape", SHAPES)
def test_all_directions_are_about_as_long_whatever_the_gradient(shape):
    given, nearest = matrix(shape, dtype=torch.float32)
    for scale in (1e-6, 1.0, 1e6):
        made = orthogonal(scale * given).double() / max(1.0, shape[0] / shape[1]) ** 0.5
        values = torch.linalg.svdvals(made)
        assert values.min() > 0.6 and values.max() < 1.25
        assert (made * nearest).sum() / made.norm() / nearest.norm() > 0.97
    alike = (given.double() * nearest).sum() / given.double().norm() / nearest.norm()
    assert shape[0] < 8 or alike < 0.9  # the gradient itself is far from it


def test_lower_precision_is_as_good_as_float32():
    given, _ = matrix((64, 576), smallest=1e-3)
    made = orthogonal(given.float()).double()
    torch.testing.assert_close(made, orthogonal(given), atol=1e-4, rtol=0)
    half = given.bfloat16()
    torch.testing.assert_close(orthogonal(half), orthogonal(half.float()).bfloat16())


@pytest.mark.parametrize("shape", [(64, 576), (576, 64)])
def test_one_direction_alone_is_kept_finite_and_none_is_none(shape):
    g = torch.Generator().manual_seed(0)
    made = orthogonal(torch.randn(shape[0], 1, generator=g) @ torch.randn(1, shape[1], generator=g))
    values = torch.linalg.svdvals(made) / max(1.0, shape[0] / shape[1]) ** 0.5
    assert 0.6 < values[0] < 1.25 and values[1] < 1e-3
    assert orthogonal(torch.zeros(shape)).abs().max() == 0


class Shift(nn.Module):
    """A learnt shift (1, C, 1, 1), as a position embedding is one."""

    def __init__(self):
        super().__init__()
        self.by = nn.Parameter(torch.zeros(1, 8, 1, 1))

    def forward(self, x):
        return x + self.by


def network():
    torch.manual_seed(0)
    return nn.Sequential(
        nn.Conv2d(3, 8, 3),
        nn.BatchNorm2d(8),
        nn.Conv2d(8, 8, 3, groups=8),
        nn.Conv2d(8, 8, 1, groups=2),
        Shift(),
        nn.Flatten(),
        nn.Linear(8 * 4, 5),
    )


MATRICES = {"0.weight", "3.weight", "6.weight"}  # neither the depthwise one nor the shift


def loss(model):
    x = torch.rand(16, 3, 6, 6, generator=torch.Generator().manual_seed(1))
    return nn.functional.cross_entropy(model(x), torch.arange(16) % 5)


def take_step(model, optimizer):
    optimizer.zero_grad()
    loss(model).backward()
    optimizer.step()


def test_matrices_take_orthogonal_steps_and_the_others_those_of_sgd():
    model, other = network(), network()
    muon = Muon(model.parameters(), lr=0.01, momentum=0.9, weight_decay=0.0)
    others = [p for name, p in other.named_parameters() if name not in MATRICES]
    sgd = torch.optim.SGD(others, SGD_LR * 0.01, momentum=0.9, nesterov=True)
    for _ in range(3):
        before = {name: p.detach().clone() for name, p in model.named_parameters()}
        for net, optimizer in ((model, muon), (other, sgd)):
            take_step(net, optimizer)
        for name, p in model.named_parameters():
            step = p.detach() - before[name]
            if name in MATRICES:
                rows, columns = step.flatten(1).shape
                tall = max(1.0, rows / columns) ** 0.5
                assert 0.006 < torch.linalg.svdvals(step.flatten(1)).max() / tall < 0.0125
                other.get_parameter(name).data.copy_(p.detach())
            else:
                torch.testing.assert_close(p, other.get_parameter(name))


def test_weight_decay_takes_from_matrices_alone():
    model = network()
    muon = Muon(model.parameters(), lr=0.1, momentum=0.9, weight_decay=0.5)
    before = {name: p.detach().clone() for name, p in model.named_parameters()}
    for p in model.parameters():
        p.grad = torch.zeros_like(p)
    muon.step()
    for name, p in model.named_parameters():
        kept = 0.95 if name in MATRICES else 1.0
        torch.testing.assert_close(p, kept * before[name])


@pytest.mark.parametrize("memory_format", [torch.contiguous_format, torch.channels_last])
def test_it_learns_and_goes_on_from_its_state(memory_format):
    model = network().to(memory_format=memory_format)
    muon = Muon(model.parameters(), lr=0.02, momentum=0.9, weight_decay=0.05)

    def closure():
        muon.zero_grad()
        value = loss(model)
        value.backward()
        return value

    first = muon.step(closure).item()
    for _ in range(20):
        take_step(model, muon)
    assert loss(model).item() < 0.5 * first

    again = network().to(memory_format=memory_format)
    again.load_state_dict(model.state_dict())
    resumed = Muon(again.parameters(), lr=0.5, momentum=0.0, weight_decay=0.0)
    resumed.load_state_dict(copy.deepcopy(muon.state_dict()))  # or they share buffers
    for net, optimizer in ((model, muon), (again, resumed)):
        take_step(net, optimizer)
    for p, q in zip(model.parameters(), again.parameters(), strict=True):
        torch.testing.assert_close(p, q)
