"""The lens."""

from __future__ import annotations

from dataclasses import dataclass

from moireaug.common.physics.lens import MIN_LENS_SLOPE
from moireaug.scene.fields import Part, Range, bounds, ranged


@dataclass(frozen=True, kw_only=True)
class Lens(Part):
    """The optics. Both coefficients map photo to ideal coordinates,
    `ideal = p (1 + k1 r^2 + k2 r^4)`, r = 1 in the photo's corners: a positive coefficient bends
    the photo like a barrel, a negative one like a pincushion.

    Args:
        k1, k2: radial distortion. Ranges.
        blur: standard deviation of the Gaussian point spread function, in sensor pixels, defocus
            included. A range.
        motion_x, motion_y: standard deviation of the motion blur of a moving hand along the
            sensor's axes, in sensor pixels. If both are given, the blur runs along a diagonal; if
            their signs differ, along the other one. It is exact for the moiré; for the picture, it
            is exact up to seven panel pixels and isotropic beyond. Ranges.
        olpf: distance between the four copies of the picture that an optical low-pass filter makes,
            along both axes, in sensor pixels; 0 is no filter. A range.
        vignetting: share of the light that is lost in the photo's corners; it falls off with the
            fourth power of the cosine. A range.
    """

    k1: Range = ranged(0.0, -1.0, 1.0)
    k2: Range = ranged(0.0, -1.0, 1.0)
    blur: Range = ranged(0.0, 0.0, 20.0, "sensor pixels")
    motion_x: Range = ranged(0.0, -20.0, 20.0, "sensor pixels")
    motion_y: Range = ranged(0.0, -20.0, 20.0, "sensor pixels")
    olpf: Range = ranged(0.0, 0.0, 4.0, "sensor pixels")
    vignetting: Range = ranged(0.0, 0.0, 0.99)

    def __post_init__(self) -> None:
        super().__post_init__()
        if hasattr(self.k1, "shape") or hasattr(self.k2, "shape"):
            return
        for k1 in bounds(self.k1):
            for k2 in bounds(self.k2):
                slope = least_lens_slope(k1, k2)
                if slope <= MIN_LENS_SLOPE:
                    raise ValueError(
                        f"Lens.k1 = {self.k1!r}, Lens.k2 = {self.k2!r} fold the photo onto itself "
                        "before its corners: 1 + 3 k1 r^2 + 5 k2 r^4 must stay above "
                        f"{MIN_LENS_SLOPE} for r in [0, 1], and is {slope:.3g} at "
                        f"k1 = {k1:g}, k2 = {k2:g}. Bring the coefficients closer to 0."
                    )


def least_lens_slope(k1: float, k2: float) -> float:
    """Return the least slope of r (1 + k1 r^2 + k2 r^4) for r in [0, 1]: at an end, or where its
    own slope is 0."""
    squared_radii = [0.0, 1.0]
    if k2:
        squared_radii.append(min(max(-0.3 * k1 / k2, 0.0), 1.0))
    return min(1 + 3 * k1 * r2 + 5 * k2 * r2 * r2 for r2 in squared_radii)
