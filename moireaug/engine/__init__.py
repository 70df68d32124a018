"""The engine: `expose` and `develop` as fused kernels, which compute the same numbers as the
reference.

It runs on the CPU and on GPUs, on float32, half precision (computed in float32) and uint8, for the
exposures "spectral", "mean" and "point". `expose` is differentiable in the image, `develop` in the
raw reading, and both in the shot's numbers, by central differences (`differences`); a point
exposure has no slope in them. The reference, `moireaug.camera.pipeline`, does the rest.
`explain(scene)` says which one a scene gets. `reference()` turns the engine off.

A call is decided by `execution`, from the table in `backends`, before its picture is met. Its two
`stages` have lower/ make records of its shot, and the kernels of cpu/ or gpu/ fill its photo;
`operators` gives them a gradient. Importing this package imports neither numba nor Triton; the
first photo does.

From a batch to a row, exposing goes through a backend's `launch_expose`, and on the CPU
`show_kernel` and `full_grid_kernel` for one image, `expose_full_kernel` and `full.expose_rows` for
some of its rows; developing, through `develop_kernel` for some images or some rows.
"""

import moireaug.engine.cpu.threads  # noqa: F401  one thread in forked processes, before any is forked
from moireaug.engine.backends import reference
from moireaug.engine.execution import explain

__all__ = ["explain", "reference"]
