"""Where a sensor pixel looks, and the Jacobian there, in float64; how far its view of the panel
spreads, a box and a Gaussian along each axis, and the light that it gets from a subpixel, see
`moireaug.camera.exposure.footprint`."""

from __future__ import annotations

import math

from moireaug.common.physics.footprint import MIN_BLUR_VARIANCE
from moireaug.common.physics.lens import MIN_RAY_DEPTH, NEWTON_STEPS
from moireaug.engine.cpu.compiling import jit_in_place
from moireaug.engine.cpu.normal import integral
from moireaug.engine.cpu.physics import footprint, lens
from moireaug.engine.cpu.vectors import load, store

BOX, SIGMA = range(2)  # columns of a blur


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


@jit_in_place
def blur_jacobian(by_camera, u, v, view):
    """Return the Jacobian of a PixelView's blur camera at a photo point, as `view.jacobian` does;
    by_camera: that of its camera."""
    camera, blur_camera = view.camera, view.blur_camera
    if blur_camera.rectified != 0:
        return jacobian(u, v, blur_camera)
    xu, xv, yu, yv = by_camera
    across, down = camera.scale_u / blur_camera.scale_u, camera.scale_v / blur_camera.scale_v
    return xu * across, xv * down, yu * across, yv * down


@jit_in_place
def motion_sigma(by_u, by_v, blur_camera):
    """Return the standard deviation of motion blur along one axis, in panel pixels, with a sign."""
    return footprint.motion_sigma(by_u, by_v, blur_camera.motion_x, blur_camera.motion_y)


@jit_in_place
def still_variance(by_u, by_v, fill, blur_u, blur_v, blur_camera):
    """Return the variance of the blur along one axis without its box and without motion, in squared
    panel pixels."""
    of_lens = footprint.lens_variance(blur_u, blur_v, blur_camera.blur, blur_camera.olpf)
    return footprint.side_variance(min(abs(by_u), abs(by_v)) * fill) + of_lens


@jit_in_place
def _fill_axis(out, steps, view, kind, axis):
    """Do the same as `fill_blur` along one axis.

    steps: panel pixels per sensor pixel along u and v, by the Jacobians of both cameras.
    """
    by_u, by_v, blur_u, blur_v = steps
    camera, blur_camera, period = view.camera, view.blur_camera, view.cell.period[kind, axis]
    long = max(abs(by_u), abs(by_v)) * camera.fill / period
    moves = motion_sigma(blur_u, blur_v, blur_camera)
    variance = still_variance(by_u, by_v, camera.fill, blur_u, blur_v, blur_camera) + moves * moves
    variance = variance / (period * period) + view.added_variance[kind, axis]
    sigma = math.sqrt(variance + MIN_BLUR_VARIANCE)
    shrink = footprint.narrowing(long, sigma, view.widths[kind, axis], view.cell.radius + 0.5)
    out[BOX], out[SIGMA] = long * shrink, sigma * shrink
    return shrink < 1


@jit_in_place
def fill_blur(out, u, v, view, kind):
    """Fill out (axis, 2) with the blur of a PixelView of a kind of subpixel at a photo point: the
    box and the standard deviation along both axes, in cells, narrowed to what the cells that are
    looked at hold, as `Footprint.fitted` does. Return whether any was narrowed."""
    by_camera = jacobian(u, v, view.camera)
    by_blur = blur_jacobian(by_camera, u, v, view)
    (xu, xv, yu, yv), (bxu, bxv, byu, byv) = by_camera, by_blur
    in_x = _fill_axis(out[0], (xu, xv, bxu, bxv), view, kind, 0)
    in_y = _fill_axis(out[1], (yu, yv, byu, byv), view, kind, 1)
    return in_x or in_y


@jit_in_place
def fill_blurs(out, us, vs, view, kind):
    """Fill out (rows * cols, axis, 2) with the blur at nodes of the photo; see `fill_blur`."""
    for r in range(len(vs)):
        for c in range(len(us)):
            fill_blur(out[r * len(us) + c], us[c], vs[r], view, kind)


@jit_in_place
def light_from(x, box, sigma, width):
    """Return the light from a subpixel at distance x, of all light that a box of 1 would see."""
    far, near = (box + width) / 2, (box - width) / 2
    seen = integral(x + far, sigma) - integral(x + near, sigma)
    return max(seen - integral(x - near, sigma) + integral(x - far, sigma), 0.0)
