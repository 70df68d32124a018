"""The CPU's kernels on batches; see `engine.backends.Backend.kernels`."""

from moireaug.engine.cpu.run_develop import develop, develop_back
from moireaug.engine.cpu.run_expose import expose, fits
from moireaug.engine.cpu.run_expose_back import expose_back

__all__ = ["develop", "develop_back", "expose", "expose_back", "fits"]
