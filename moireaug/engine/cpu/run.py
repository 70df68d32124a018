"""The CPU's kernels on batches; see `engine.backends.Backend.kernels`."""

from moireaug.engine.cpu.run_develop import develop, develop_back
from moireaug.engine.cpu.run_expose import expose, fits

__all__ = ["develop", "develop_back", "expose", "fits"]
