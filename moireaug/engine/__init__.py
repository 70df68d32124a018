"""The engine: `expose` and `develop` as fused CPU kernels, a sensor row at a time; the same numbers
as the reference's.

It runs on the CPU, on float32, half precision (computed in float32) and bytes, for the exposures
"spectral", "mean" and "point", where no gradient is asked of the image or the shot; `develop` has a
gradient in the raw reading. All else is the reference's: `moireaug.pipeline`. `explain(scene)` says
which a scene gets. `reference()` turns the engine off.

Importing this package does not import numba; the first photo does.
"""

from moireaug.engine.dispatch import explain, reference

__all__ = ["explain", "reference"]
