"""Where a pixel looks, and the Jacobian there.

`camera` points to one image's Camera, float64. Photo points u, v lie about the photo's centre.
Positions are float64, because a phase is what is left of thousands of cycles; the Jacobian is
float32.
"""

from __future__ import annotations

import triton
import triton.language as tl

from moireaug.common.physics.lens import NEWTON_STEPS as STEPS
from moireaug.engine.gpu.arrays import camera_field
from moireaug.engine.gpu.physics import lens
from moireaug.scene.geometry import grids

H00 = camera_field("h00")  # and the other eight entries, row by row
K1, K2, RADIUS_SCALE = camera_field("k1"), camera_field("k2"), camera_field("radius_scale")
ALPHA = camera_field("alpha")
PHOTO_HEIGHT, PHOTO_WIDTH = camera_field("photo_height"), camera_field("photo_width")
CENTRE_U, CENTRE_V = camera_field("centre_u"), camera_field("centre_v")
CORNER_X, CORNER_Y = camera_field("corner_x"), camera_field("corner_y")
SCALE_U, SCALE_V = camera_field("scale_u"), camera_field("scale_v")

MAX_STEP = tl.constexpr(grids.MAX_STEP)
NEWTON_STEPS = tl.constexpr(STEPS)


@triton.jit
def homography_at(entries):
    """Return the nine entries of a homography, float64."""
    return (
        tl.load(entries), tl.load(entries + 1), tl.load(entries + 2),
        tl.load(entries + 3), tl.load(entries + 4), tl.load(entries + 5),
        tl.load(entries + 6), tl.load(entries + 7), tl.load(entries + 8),
    )  # fmt: skip


@triton.jit
def to_image(u, v, camera):
    """Return the image point x, y that a photo point sees, float64."""
    radius_scale, k1, k2 = lens_of(camera)
    factor = lens.radial_factor((u * u + v * v) * radius_scale, k1, k2)
    return lens.project(u * factor, v * factor, homography_at(camera + H00))


@triton.jit
def undistortion(ideal, k1, k2):
    """Return the factor that takes ideal points at a radius to photo points, float64, as
    `distortion.inverse_radial_factor` does: all steps but the last two in float32."""
    near, a, b = ideal.to(tl.float32), k1.to(tl.float32), k2.to(tl.float32)
    r = lens.newton_start(near, a, b)
    for _ in tl.static_range(NEWTON_STEPS - 1):
        r = lens.newton_step(r, near, a, b)
    exact = lens.newton_step(lens.newton_step(r.to(tl.float64), ideal, k1, k2), ideal, k1, k2)
    beyond = lens.tangent_radius(ideal, k1, k2)
    radius = tl.where(beyond > 1.0, beyond, exact)
    tiny = ideal < 1e-12
    return tl.where(tiny, 1.0, radius / tl.where(tiny, 1.0, ideal))


@triton.jit
def to_photo(x, y, forward, photo_lens, DISTORTS: tl.constexpr):
    """Return the photo point u, v that shows an image point x, y about the image's centre, float64.

    Args:
        forward: (9,) float64, the homography from image to ideal photo coordinates.
        photo_lens: from `lens_of`. DISTORTS: whether it distorts.
    """
    u, v = lens.project(x, y, homography_at(forward))
    if DISTORTS:
        radius_scale, k1, k2 = photo_lens
        factor = undistortion(tl.sqrt((u * u + v * v) * radius_scale), k1, k2)
        u, v = u * factor, v * factor
    return u, v


@triton.jit
def lens_of(camera):
    """Return `radius_scale`, k1 and k2 of a Camera."""
    return tl.load(camera + RADIUS_SCALE), tl.load(camera + K1), tl.load(camera + K2)


@triton.jit
def load32(camera, FIELD: tl.constexpr):
    """Return a field of a Camera as float32."""
    return tl.load(camera + FIELD).to(tl.float32)


@triton.jit
def jacobian(u, v, camera):
    """Return the change of panel x and y per sensor pixel along u and v at a photo point, as xu,
    xv, yu, yv; float32."""
    radius_scale, k1, k2 = lens_of(camera)
    photo_lens = radius_scale.to(tl.float32), k1.to(tl.float32), k2.to(tl.float32)
    h = (
        load32(camera, H00), load32(camera, H00 + 1), load32(camera, H00 + 2),
        load32(camera, H00 + 3), load32(camera, H00 + 4), load32(camera, H00 + 5),
        load32(camera, H00 + 6), load32(camera, H00 + 7), load32(camera, H00 + 8),
    )  # fmt: skip
    xu, xv, yu, yv = lens.image_jacobian(u.to(tl.float32), v.to(tl.float32), photo_lens, h)
    largest = tl.maximum(tl.maximum(tl.abs(xu), tl.abs(xv)), tl.maximum(tl.abs(yu), tl.abs(yv)))
    alpha = load32(camera, ALPHA) / tl.maximum(largest / MAX_STEP, 1.0)
    by_u, by_v = alpha / load32(camera, SCALE_U), alpha / load32(camera, SCALE_V)
    return by_u * xu, by_v * xv, by_u * yu, by_v * yv
