"""Switches that others set for their own reasons: debuggers, notebooks, launchers of jobs. Whatever
they switch off is done without, and nothing ends in an error of somebody else's library."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from moireaug import Scene
from moireaug.common import extras
from moireaug.engine import backends, execution

ROOT = Path(__file__).resolve().parents[1]
SWITCHES = {
    "NUMBA_DISABLE_JIT": "1",
    "MPLBACKEND": "module://notebook.backend_that_is_not_installed",
    "OMP_NUM_THREADS": "garbage",
    "PYTORCH_JIT": "0",
    "PYTHONIOENCODING": "ascii",
    "COLUMNS": "20",
    "TERM": "dumb",
    "HOME": "/nowhere",
}
EVERYTHING = """
import sys

import torch

sys.settrace(lambda *given: None)  # as debuggers do; imports of PyTorch would take ten seconds more
from moireaug import attacks
from training.system import messages
from moireaug.transforms import RandomMoire

scene = "screen_photo"
model = torch.nn.Sequential(torch.nn.Flatten(), torch.nn.Linear(3 * 8 * 8, 3))
images = torch.rand(2, 3, 8, 8)
labels = model(images).argmax(1)
photo = RandomMoire(scene)(images)
assert photo.isfinite().all()
assert attacks.MoireAttack(model, scene=scene, eps=0.1, steps=2)(images, labels).noise.any()
messages.prepare_output()
print("Moir\\u00e9")
"""
EXECUTIONS = [
    ({}, ""),
    ({"NUMBA_DISABLE_JIT": "0"}, ""),
    ({"NUMBA_DISABLE_JIT": "off"}, ""),  # numba takes it for 0, and warns
    ({"NUMBA_DISABLE_JIT": "1"}, "NUMBA_DISABLE_JIT is set"),
]


def test_whatever_others_switch_off_is_done_without():
    command, given = [sys.executable, "-c", EVERYTHING], {"cwd": ROOT, "env": os.environ | SWITCHES}
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, **given)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "Moire\n"


@pytest.mark.parametrize(("environment", "reason"), EXECUTIONS)
def test_the_reference_runs_where_numba_compiles_nothing(environment, reason, monkeypatch):
    monkeypatch.delenv("NUMBA_DISABLE_JIT", raising=False)
    monkeypatch.delitem(sys.modules, "numba.core.config", raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    backends._why_no_numba.cache_clear()
    try:
        scene = Scene.preset("screen_photo")
        found = execution.execution_of(scene, scene.plan())
        for why in (found.why_not_expose, found.why_not_develop):
            assert why.startswith(reason) and bool(why) == bool(reason)
    finally:
        backends._why_no_numba.cache_clear()


@pytest.mark.parametrize(("backend", "kept"), [("svg", True), ("nothing", False)])
def test_a_backend_that_is_not_installed_is_dropped(backend, kept, monkeypatch):
    import matplotlib

    # as if it had not been imported yet
    monkeypatch.delitem(sys.modules, "matplotlib")
    monkeypatch.setattr(extras.importlib, "import_module", lambda name: matplotlib)
    monkeypatch.setitem(os.environ, "MPLBACKEND", backend)
    with matplotlib.rc_context():
        extras.drop_missing_backend()
    assert os.environ.get("MPLBACKEND") == (backend if kept else None)
