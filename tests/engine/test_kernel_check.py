"""Kernels are used where they can be imported and, on a GPU, give the reference's results; they are
left alone elsewhere."""

import logging
import re

import pytest
import torch

from moireaug import Scene, capture
from moireaug.engine import backends, kernel_stage
from moireaug.engine.backends import reference


def fails(*_):
    raise RuntimeError("no kernel image is available\nfor this device")


def numba_of_another_version(*_):
    raise TypeError("njit() got an unexpected keyword argument '_nrt'")


def doubled(values, saves):
    return values * 2, values


def slope(grad, values, saved):
    return grad * 2


# forward and backward kernels, and how they fail
STAGES = {
    "equal": (doubled, slope, ""),
    "another photo": (lambda values, saves: (values * 2.01, values), slope, "differ from the refe"),
    "not a number": (lambda values, saves: (values / 0 * 0, values), slope, "differ from the refe"),
    "no launch": (fails, slope, r"do not run \(RuntimeError: no kernel image is available\)"),
    "no launch of the gradient": (doubled, fails, r"do not run \(RuntimeError: no kernel image"),
    "another photo in a batch": (
        lambda values, saves: (values * 2 + torch.eye(64)[0].view(-1, 1, 1, 1) / 64, values),
        slope,
        "differ from the reference by 0.02 RMS",
    ),
    "another gradient": (doubled, lambda grad, *_: grad * 2.2, "give a gradient that differs from"),
    "infinite gradient": (doubled, lambda grad, *_: grad / 0, "give a gradient that is not finite"),
}


class Doubling:
    """Twice its values, by some functions in the place of kernels."""

    def __init__(self, forward, backward, reference=lambda values: values * 2):
        self.functions = forward, backward, reference

    def forward(self, values, saves):
        return self.functions[0](values, saves)

    def backward(self, grad, values, saved):
        return self.functions[1](grad, values, saved)

    def reference(self, values):
        return self.functions[2](values)

    def part(self, mask):
        return self

    def variant(self):
        return "doubling"


def stage_of(name):
    return Doubling(*STAGES[name][:2])


@pytest.mark.parametrize("name", STAGES)
def test_kernels_are_held_against_the_reference(name):
    message = STAGES[name][2]
    failure = kernel_stage.failure_of(stage_of(name), torch.rand(64, 3, 4, 5), back=True)
    assert re.match(message, failure) and bool(failure) == bool(message)
    if "gradient" in name:  # tried where one is asked for
        assert not kernel_stage.failure_of(stage_of(name), torch.rand(64, 3, 4, 5), back=False)


@pytest.fixture
def said(monkeypatch):
    """What the package's logger warns of."""
    told = []
    monkeypatch.setattr(logging.getLogger("moireaug"), "warning", told.append)
    return told


def test_a_batch_too_large_for_the_reference_is_not_compared(monkeypatch):
    def lacks_memory(values):
        raise torch.OutOfMemoryError("CUDA out of memory")

    monkeypatch.setattr(kernel_stage, "_agreements", {})
    stage = Doubling(doubled, slope, lacks_memory)
    assert kernel_stage.failure_of(stage, torch.rand(2, 3, 4, 5), back=True) is None
    monkeypatch.setattr(kernel_stage, "failure_of", lambda *_, back: None)
    batch = torch.empty(1, 3, 2, 2, device="meta")
    assert kernel_stage.matches_reference(stage, batch, back=False)
    assert not kernel_stage._agreements


def test_kernels_are_tried_for_each_dtype_and_a_failure_is_reported_once(said, monkeypatch):
    failures = {torch.float32: "", torch.uint8: "do not run"}
    monkeypatch.setattr(kernel_stage, "_agreements", {})
    monkeypatch.setattr(
        kernel_stage, "failure_of", lambda stage, values, back: failures[values.dtype]
    )
    # any device but the CPU
    batches = [torch.empty(1, 3, 2, 2, device="meta", dtype=dtype) for dtype in failures]
    verdicts = []
    for batch in 2 * batches:
        verdicts.append(kernel_stage.matches_reference(stage_of("equal"), batch, back=False))
    assert verdicts == [True, False, True, False]
    assert len(said) == 1


def test_kernels_of_the_cpu_are_not_tried():
    stage = Doubling(fails, fails, fails)
    assert kernel_stage.matches_reference(stage, torch.rand(1, 3, 2, 2), back=True)


def test_kernels_that_cannot_be_imported_are_left_alone(said, monkeypatch):
    images, shot = torch.rand(1, 3, 8, 8), Scene.preset("screen_photo").sample(1, (8, 8))
    with reference():
        expected = capture(images, shot)
    broken = backends.backend_of("cpu")._replace(module="moireaug.engine.cpu.missing")
    monkeypatch.setattr(backends, "BACKENDS", (broken,))
    assert torch.equal(capture(images, shot), expected)
    monkeypatch.setattr(backends, "BACKENDS", (broken._replace(name="newer"),))
    monkeypatch.setattr(backends.Backend, "kernels", numba_of_another_version)
    assert torch.equal(capture(images, shot), expected)
    assert [sentence.split(":")[0] for sentence in said] == [
        "moireaug's numba kernels cannot be imported (ModuleNotFoundError",
        "moireaug's newer kernels cannot be imported (TypeError",
    ]
