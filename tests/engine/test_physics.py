"""A formula gives the same numbers over every library that it is bound to."""

import inspect
import math
import types

import numba
import numpy as np
import pytest
import torch

from moireaug.common import tensor_physics
from moireaug.common.physics import (
    aliases,
    clipping,
    footprint,
    lens,
    optics,
    panel,
    sensor,
    srgb,
    tone,
)
from moireaug.common.physics.binding import bind
from moireaug.engine.cpu import beat_terms, physics
from moireaug.engine.cpu import sensor as cpu_sensor

N = 50
FORMULAS = [
    (module, name)
    for module in (aliases, clipping, footprint, lens, optics, panel, sensor, srgb, tone)
    for name, value in vars(module).items()
    if inspect.isfunction(value) and value.__module__ == module.__name__
]
LENGTHS = {
    "lens": 3,
    "h": 9,
    "optics": 5,
    "cycles": 2,
    "side_u": 2,
    "side_v": 2,
}  # of arguments that are tuples
FLAGS = {"is_odd", "is_odd_u", "is_odd_v"}
OPERATIONS = physics.OPERATIONS | {
    "sinc": beat_terms.sinc,
    "power": pow,
    "exp": math.exp,
    "normal_cdf": numba.njit(lambda z: 0.5 * math.erfc(-z * 0.5**0.5)),
    "cos_pi": numba.njit(lambda x: math.cos(math.pi * x)),
}


def random_arguments(function):
    rng = np.random.default_rng(0)
    arguments = []
    for name in inspect.signature(function).parameters:
        if name in LENGTHS:
            arguments.append(tuple(rng.uniform(0.01, 0.1, N) for _ in range(LENGTHS[name])))
        elif name in FLAGS:
            arguments.append(rng.random(N) < 0.5)
        else:
            arguments.append(rng.uniform(0.01, 1.0, N))
    return arguments


def picked(arguments, change):
    """Arguments with `change` applied to each array."""
    return [tuple(map(change, a)) if isinstance(a, tuple) else change(a) for a in arguments]


def stacked(results):
    return np.stack([np.broadcast_to(r, N) for r in results]) if type(results) is tuple else results


@pytest.mark.parametrize(
    ("module", "name"),
    [pair for pair in FORMULAS if pair[1] != "panel_jacobian"],
    ids=lambda value: value if isinstance(value, str) else value.__name__.rsplit(".")[-1],
)
def test_numpy_torch_and_numba_agree(module, name):
    arguments = random_arguments(getattr(module, name))
    expected = stacked(getattr(module, name)(*arguments))
    short = module.__name__.rsplit(".", 1)[-1]
    by_torch = getattr(getattr(tensor_physics, short), name)(*picked(arguments, torch.from_numpy))
    by_torch = by_torch if isinstance(by_torch, tuple) else (by_torch,)
    np.testing.assert_allclose(
        np.stack([t.numpy() for t in by_torch]).reshape(np.shape(expected)), expected, rtol=1e-6
    )
    compiled = getattr(bind(short, OPERATIONS, numba.njit(error_model="numpy")), name)
    one = [compiled(*picked(arguments, lambda a, i=i: a[i].item())) for i in range(N)]
    np.testing.assert_allclose(
        np.asarray(one).T.reshape(np.shape(expected)), expected, rtol=1e-5, atol=2e-6
    )


def test_the_hash_agrees():
    bits = np.random.default_rng(1).integers(0, 2**32, N, np.uint32)
    with np.errstate(over="ignore"):
        wrapped = types.SimpleNamespace(mix=bind("random_numbers", {}, constant=np.uint32).mix)
        expected = wrapped.mix(bits)
    by_torch = tensor_physics.random_numbers.mix(torch.from_numpy(bits.view(np.int32)))
    assert (by_torch.numpy().view(np.uint32) == expected).all()
    mix = physics.random_numbers.mix
    compiled = numba.njit(lambda x: mix(x))
    assert [compiled(x) for x in bits] == expected.tolist()


@pytest.mark.parametrize("variances", [(0.0, 0.0, 0.0), (1e-4, 1e-3, 0.3), (1e-3, 1e-3, 9.0)])
def test_the_mean_of_clipped_pixels_and_its_slope(variances):
    """Of the CPU's kernel, which takes tables and short cuts."""
    dark, photons, pattern = variances
    clip_mean = cpu_sensor.clip_mean

    @numba.njit
    def clipped(out, light, slope, dark, photons, pattern):
        clip_mean(out, light, slope, dark, photons, pattern)

    light = np.linspace(-0.05, 3, N, dtype=np.float32)
    out, slope = np.empty(N, np.float32), np.ones(N, np.float32)
    clipped(out, light, slope, *map(np.float32, variances))
    exact = torch.from_numpy(light).double().requires_grad_()
    noise = dark + photons * exact.clamp(min=1e-4)
    expected = tensor_physics.clipping.expected_clip(exact, noise, exact.square() * pattern)
    (grad,) = torch.autograd.grad(expected.sum(), exact)
    np.testing.assert_allclose(out, expected.detach(), atol=1e-5)
    np.testing.assert_allclose(slope, grad, atol=1e-3)
