"""Where a pixel looks, and the Jacobian there.

`camera` points to one image's Camera, float64. Photo points u, v lie about the photo's centre.
Positions are float64, because a phase is what is left of thousands of cycles; the Jacobian is
float32.
"""

from __future__ import annotations

import triton
import triton.language as tl

from moireaug.engine.gpu.arrays import camera_field
from moireaug.scene import lens
from moireaug.scene.geometry import distortion, grids

H00, H01, H02 = camera_field("h00"), camera_field("h01"), camera_field("h02")
H10, H11, H12 = camera_field("h10"), camera_field("h11"), camera_field("h12")
H20, H21, H22 = camera_field("h20"), camera_field("h21"), camera_field("h22")
K1, K2, RADIUS_SCALE = camera_field("k1"), camera_field("k2"), camera_field("radius_scale")
ALPHA = camera_field("alpha")
PHOTO_HEIGHT, PHOTO_WIDTH = camera_field("photo_height"), camera_field("photo_width")
CENTRE_U, CENTRE_V = camera_field("centre_u"), camera_field("centre_v")
CORNER_X, CORNER_Y = camera_field("corner_x"), camera_field("corner_y")
SCALE_U, SCALE_V = camera_field("scale_u"), camera_field("scale_v")

MIN_RAY_DEPTH = tl.constexpr(grids.MIN_RAY_DEPTH)
MAX_STEP = tl.constexpr(grids.MAX_STEP)
NEWTON_STEPS = tl.constexpr(distortion.NEWTON_STEPS)
MIN_LENS_SLOPE = tl.constexpr(lens.MIN_LENS_SLOPE)


@triton.jit
def to_image(u, v, camera):
    """Return the image point x, y that a photo point sees, float64."""
    radius_scale, k1, k2 = lens_of(camera)
    r2 = (u * u + v * v) * radius_scale
    lens_factor = 1.0 + r2 * (k1 + k2 * r2)
    x, y, depth = homogeneous(camera + H00, u * lens_factor, v * lens_factor)
    nearness = 1.0 / tl.maximum(depth, MIN_RAY_DEPTH)
    return x * nearness, y * nearness


@triton.jit
def newton_step(r, ideal, k1, k2):
    """Return a better radius that a lens takes to an ideal one, from 0 to the photo's corner, 1."""
    r2 = r * r
    error = r * (1.0 + r2 * (k1 + k2 * r2)) - ideal
    slope = tl.maximum(1.0 + r2 * (3.0 * k1 + 5.0 * k2 * r2), MIN_LENS_SLOPE)
    return tl.minimum(tl.maximum(r - error / slope, 0.0), 1.0)


@triton.jit
def undistortion(ideal, k1, k2):
    """Return the factor that takes ideal points at a radius to photo points, float64, as
    `distortion.inverse_radial_factor` does: all steps but the last two in float32."""
    near, a, b = ideal.to(tl.float32), k1.to(tl.float32), k2.to(tl.float32)
    # where Newton's method may start: the squared radius at which the lens's curve has no bend
    inflection = -0.3 * a / tl.where(b == 0.0, 1.0, b)
    has_inflection = (b != 0.0) & (inflection > 0.0) & (inflection < 1.0)
    start = tl.sqrt(tl.where(has_inflection, inflection, 1.0))
    r = tl.where(has_inflection, start, tl.minimum(near, 1.0))
    for _ in tl.static_range(NEWTON_STEPS - 1):
        r = newton_step(r, near, a, b)
    exact = newton_step(newton_step(r.to(tl.float64), ideal, k1, k2), ideal, k1, k2)
    # beyond the corner the curve may fold: its tangent there is followed
    beyond = 1.0 + (ideal - 1.0 - k1 - k2) / (1.0 + 3.0 * k1 + 5.0 * k2)
    radius = tl.where(beyond > 1.0, beyond, exact)
    tiny = ideal < 1e-12
    return tl.where(tiny, 1.0, radius / tl.where(tiny, 1.0, ideal))


@triton.jit
def homogeneous(homography, x, y):
    """Return homogeneous coordinates of points x, y through a homography (9,) float64."""
    return (
        tl.load(homography) * x + tl.load(homography + 1) * y + tl.load(homography + 2),
        tl.load(homography + 3) * x + tl.load(homography + 4) * y + tl.load(homography + 5),
        tl.load(homography + 6) * x + tl.load(homography + 7) * y + tl.load(homography + 8),
    )


@triton.jit
def to_photo(x, y, forward, lens, DISTORTS: tl.constexpr):
    """Return the photo point u, v that shows an image point x, y about the image's centre, float64.

    Args:
        forward: (9,) float64, the homography from image to ideal photo coordinates.
        lens: `radius_scale`, k1 and k2, see `exposure_records.Camera`. DISTORTS: whether it
            distorts.
    """
    u, v, depth = homogeneous(forward, x, y)
    nearness = 1.0 / tl.maximum(depth, MIN_RAY_DEPTH)
    u, v = u * nearness, v * nearness
    if DISTORTS:
        radius_scale, k1, k2 = lens
        factor = undistortion(tl.sqrt((u * u + v * v) * radius_scale), k1, k2)
        u, v = u * factor, v * factor
    return u, v


@triton.jit
def lens_of(camera):
    """Return the lens of a Camera, as `to_photo` takes it."""
    return tl.load(camera + RADIUS_SCALE), tl.load(camera + K1), tl.load(camera + K2)


@triton.jit
def load32(camera, FIELD: tl.constexpr):
    """Return a field of a Camera as float32."""
    return tl.load(camera + FIELD).to(tl.float32)


@triton.jit
def jacobian(u, v, camera):
    """Return the change of panel x and y per sensor pixel along u and v at a photo point, as xu,
    xv, yu, yv; float32."""
    u, v = u.to(tl.float32), v.to(tl.float32)
    radius_scale, k1, k2 = load32(camera, RADIUS_SCALE), load32(camera, K1), load32(camera, K2)
    r2 = radius_scale * (u * u + v * v)
    lens_factor, along = 1.0 + r2 * (k1 + k2 * r2), 2.0 * radius_scale * (k1 + 2.0 * k2 * r2)
    uu, uv, vv = lens_factor + along * u * u, along * u * v, lens_factor + along * v * v
    p, q = u * lens_factor, v * lens_factor
    h00, h01, h02 = load32(camera, H00), load32(camera, H01), load32(camera, H02)
    h10, h11, h12 = load32(camera, H10), load32(camera, H11), load32(camera, H12)
    h20, h21, h22 = load32(camera, H20), load32(camera, H21), load32(camera, H22)
    nearness = 1.0 / tl.maximum(h20 * p + h21 * q + h22, MIN_RAY_DEPTH)
    x, y = (h00 * p + h01 * q + h02) * nearness, (h10 * p + h11 * q + h12) * nearness
    xp, xq = (h00 - x * h20) * nearness, (h01 - x * h21) * nearness
    yp, yq = (h10 - y * h20) * nearness, (h11 - y * h21) * nearness
    xu, xv = xp * uu + xq * uv, xp * uv + xq * vv
    yu, yv = yp * uu + yq * uv, yp * uv + yq * vv
    largest = tl.maximum(tl.maximum(tl.abs(xu), tl.abs(xv)), tl.maximum(tl.abs(yu), tl.abs(yv)))
    alpha = load32(camera, ALPHA) / tl.maximum(largest / MAX_STEP, 1.0)
    by_u, by_v = alpha / load32(camera, SCALE_U), alpha / load32(camera, SCALE_V)
    return by_u * xu, by_v * xv, by_u * yu, by_v * yv
