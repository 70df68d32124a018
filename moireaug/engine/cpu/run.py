"""The CPU's kernels on batches; see `engine.backends.Backend.kernels`."""

from moireaug.engine.cpu.first_use import prepare
from moireaug.engine.cpu.launch_develop import launch_develop, launch_develop_back
from moireaug.engine.cpu.launch_expose import fits, launch_expose, launch_expose_back

SUMS_IN_ORDER = True
__all__ = [
    "SUMS_IN_ORDER",
    "fits",
    "launch_develop",
    "launch_develop_back",
    "launch_expose",
    "launch_expose_back",
    "prepare",
]
