"""The engine: `expose` and `develop` as fused CPU kernels, which work on a sensor row at a time and
compute the same numbers as the reference.

It runs on the CPU, on float32, half precision (computed in float32) and uint8, for the exposures
"spectral", "mean" and "point", unless a gradient in the image or the shot is needed; `develop` is
differentiable in the raw reading. The reference, `moireaug.pipeline`, does the rest.
`explain(scene)` says which one a scene gets. `reference()` turns the engine off.

Importing this package does not import numba; the first photo does.
"""

import os

import torch

from moireaug.engine.dispatch import explain, reference

# OpenMP's threads do not survive a fork, and whatever waits for them hangs
PROCESS = os.getpid()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=lambda: torch.set_num_threads(1))

__all__ = ["explain", "reference"]
