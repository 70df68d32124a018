"""Where a sensor pixel looks, and the Jacobian there, in float64."""

from __future__ import annotations

import math

from moireaug.common.physics.lens import MIN_RAY_DEPTH, NEWTON_STEPS
from moireaug.engine.cpu.compiling import jit_in_place
from moireaug.engine.cpu.physics import lens
from moireaug.engine.cpu.vectors import load, store


@jit_in_place
def look(x, y, cols, v, camera):
    """Fill x, y (n,) with the panel coordinates that a row v of photo columns sees, v and cols
    about the centre."""
    c = camera
    # the lens's factor as a polynomial in u * u
    b = c.radius_scale * v * v
    c0 = 1 + b * (c.k1 + c.k2 * b)
    c1 = c.radius_scale * (c.k1 + 2 * c.k2 * b)
    c2 = c.radius_scale * c.radius_scale * c.k2
    ax, bx, dx = c.alpha * c.h00, c.alpha * c.h01 * v, c.alpha * c.h02
    ay, by, dy = c.alpha * c.h10, c.alpha * c.h11 * v, c.alpha * c.h12
    az, bz, dz = c.h20, c.h21 * v, c.h22
    for i in range(len(x)):
        u = load(cols, i)
        a = u * u
        lens_factor = c0 + a * (c1 + a * c2)
        nearness = 1 / max((az * u + bz) * lens_factor + dz, MIN_RAY_DEPTH)
        store(x, i, ((ax * u + bx) * lens_factor + dx) * nearness)
        store(y, i, ((ay * u + by) * lens_factor + dy) * nearness)


@jit_in_place
def inverse(camera):
    """Return the inverse of a camera's homography, row by row."""
    c = camera
    x = c.h11 * c.h22 - c.h12 * c.h21, c.h02 * c.h21 - c.h01 * c.h22, c.h01 * c.h12 - c.h02 * c.h11
    y = c.h12 * c.h20 - c.h10 * c.h22, c.h00 * c.h22 - c.h02 * c.h20, c.h02 * c.h10 - c.h00 * c.h12
    z = c.h10 * c.h21 - c.h11 * c.h20, c.h01 * c.h20 - c.h00 * c.h21, c.h00 * c.h11 - c.h01 * c.h10
    s = 1 / (c.h00 * x[0] + c.h01 * y[0] + c.h02 * z[0])
    return (
        x[0] * s, x[1] * s, x[2] * s,
        y[0] * s, y[1] * s, y[2] * s,
        z[0] * s, z[1] * s, z[2] * s,
    )  # fmt: skip


@jit_in_place
def undistorted(ideal, k1, k2):
    """Return the radius that a lens takes to an ideal one, as `distortion.inverse_radial_factor`
    does: beyond the photo's corners, by the tangent there."""
    beyond = lens.tangent_radius(ideal, k1, k2)
    if beyond > 1:
        return beyond
    r = lens.newton_start(ideal, k1, k2)
    for _ in range(NEWTON_STEPS):
        r = lens.newton_step(r, ideal, k1, k2)
    return r


@jit_in_place
def to_photo(x, y, camera):
    """Return where an image point lies on the photo, both about the centre; camera: a rectified
    one."""
    u, v = lens.project(x, y, inverse(camera))
    if camera.k1 != 0 or camera.k2 != 0:
        ideal = math.sqrt((u * u + v * v) * camera.radius_scale)
        if ideal > 1e-9:
            factor = undistorted(ideal, camera.k1, camera.k2) / ideal
            u, v = u * factor, v * factor
    return u, v


@jit_in_place
def jacobian(u, v, camera):
    """Return `lens.panel_jacobian` at a photo point about the centre; of a rectified camera, at
    where the photo shows an image point."""
    if camera.rectified != 0:
        u, v = to_photo(u, v, camera)
    return lens.panel_jacobian(u, v, camera)
