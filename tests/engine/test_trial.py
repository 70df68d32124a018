"""A GPU's kernels are used where they give the reference's results, and left alone elsewhere."""

import logging
import re

import pytest
import torch

from moireaug.engine import trial
from moireaug.engine.autograd import Stage


def fails(values, saves):
    raise RuntimeError("no kernel image is available\nfor this device")


STAGES = {
    "equal": (lambda values, saves: (values * 2, values), ""),
    "another photo": (
        lambda values, saves: (values * 2.01, values),
        "differ from the reference by",
    ),
    "not a number": (
        lambda values, saves: (values / 0 * 0, values),
        "differ from the reference by",
    ),
    "no launch": (fails, r"do not run \(RuntimeError: no kernel image is available\)"),
}


def stage_of(name):
    forward, message = STAGES[name]
    return Stage(forward, fails, lambda values: values * 2), message


@pytest.mark.parametrize("name", STAGES)
def test_kernels_are_held_against_the_reference(name):
    stage, message = stage_of(name)
    failure = trial.why_not(stage, torch.rand(2, 3, 4, 5))
    assert re.match(message, failure) and bool(failure) == bool(message)


@pytest.mark.parametrize("failure", ["", "do not run"])
def test_a_failure_is_reported_once(failure, caplog, monkeypatch):
    monkeypatch.setattr(trial, "_agreements", {})
    monkeypatch.setattr(trial, "why_not", lambda stage, values: failure)
    values = torch.empty(1, 3, 2, 2, device="meta")  # any device but the CPU
    with caplog.at_level(logging.WARNING, "moireaug"):
        verdicts = [trial.agrees(stage_of("equal")[0], "developing", values) for _ in range(2)]
    assert verdicts == [not failure] * 2
    assert len(caplog.records) == bool(failure)


def test_kernels_of_the_cpu_are_not_tried():
    assert trial.agrees(Stage(fails, fails, fails), "developing", torch.rand(1, 3, 2, 2))
