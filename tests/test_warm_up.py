"""The command that compiles kernels beforehand leaves none for the first photo."""

import pytest
from numba.core.dispatcher import Dispatcher

from moireaug import warm_up
from moireaug.engine import backends
from moireaug.engine.cpu import compiling, develop_kernels, expose_back_kernels, expose_kernels
from moireaug.engine.cpu.kernel_cache import KernelCache

MODULES = expose_kernels, expose_back_kernels, develop_kernels


def kernels():
    """The functions that Python calls, by name."""
    found = {}
    for module in MODULES:
        for name, value in vars(module).items():
            if isinstance(value, Dispatcher) and isinstance(value._cache, KernelCache):
                found[name] = value
    return found


def test_all_kernels_are_compiled_and_their_folder_is_said(capsys):
    assert warm_up.main() == 0
    assert len(kernels()) == 14
    assert all(kernel.signatures for kernel in kernels().values())
    assert len(kernels()["show_kernel"].signatures) == 2  # of float32 and uint8
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("1 of 3: binned readings") and compiling.folder() in lines[3]


@pytest.mark.parametrize("why", ["off", "nowhere", "full"])
def test_what_is_not_kept_is_a_failure(why, monkeypatch, capsys):
    monkeypatch.setattr(warm_up, "warm_up", lambda: None)
    if why == "nowhere":
        monkeypatch.setattr(compiling, "folder", lambda: None)
    elif why == "full":
        monkeypatch.setattr(KernelCache, "is_full", True)
    with backends.reference() if why == "off" else monkeypatch.context():
        assert warm_up.main() == 1
    assert ("the engine is turned off" in capsys.readouterr().err) == (why == "off")
