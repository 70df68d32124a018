"""What the steps and the loading are timed on."""

import pytest
import torch
from hydra import initialize

from benchmarks import training_steps
from training import machine
from training.schema import register


@pytest.fixture(autouse=True)
def _hydra():
    register()
    with initialize(version_base="1.3", config_path=None):
        yield


def test_steps_take_the_precision_of_the_cpu_beside_a_gpu(monkeypatch, tmp_path):
    flags = tmp_path / "cpuinfo"
    flags.write_text("flags : fpu sse2\n")
    monkeypatch.setattr(machine, "CPUINFO", flags)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "is_bf16_supported", lambda **_: True)
    cfg = training_steps.configure("recipe=clean")
    assert machine.precision(cfg.trainer) == "32-true"
