"""The CPU's kernels on batches; see `engine.backends.Backend.kernels`."""

from moireaug.engine.cpu.run_develop import develop, develop_back
from moireaug.engine.cpu.run_expose import expose, fits
from moireaug.engine.cpu.run_expose_back import expose_back

SUMS_IN_ORDER = True
__all__ = ["SUMS_IN_ORDER", "develop", "develop_back", "expose", "expose_back", "fits"]
