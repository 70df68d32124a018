"""Kernels for a GPU run on the CPU, by Triton's interpreter, where there is none."""

import os

import pytest
import torch

if not torch.cuda.is_available():
    os.environ["TRITON_INTERPRET"] = "1"  # read when a kernel is decorated


@pytest.fixture(autouse=True)
def quick_calls(monkeypatch):
    """Let functions that a kernel calls find Triton's language as the kernel left it. The
    interpreter prepares it for each call, which takes most of a test's time."""
    interpreter = pytest.importorskip("triton.runtime.interpreter")

    def call(self, *args, **kwargs):
        return self.rewrite()(*args, **kwargs)

    monkeypatch.setattr(interpreter.InterpretedFunction, "__call__", call)


@pytest.fixture(autouse=True)
def one_program_an_image(monkeypatch, quick_calls):
    """The interpreter takes as long for a program of one pixel as of hundreds."""
    from moireaug.engine.gpu import binned, tile

    monkeypatch.setattr(tile, "TILE", (32, 64))
    monkeypatch.setattr(binned, "BLOCK", 256)
