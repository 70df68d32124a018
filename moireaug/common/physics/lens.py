"""A pinhole camera in front of the screen, and its lens.

Photo points u, v lie about the photo's centre. `lens` is `radius_scale`, which scales squared radii
to 1 in the photo's corners, k1 and k2. `h` is a homography, row by row, to image coordinates.
"""

from moireaug.common.physics.operations import maximum, minimum, sqrt, where

# a ray that meets the screen a thousand times as far away as its centre, or farther, counts as past
# the horizon
MIN_RAY_DEPTH = 1e-3
MIN_LENS_SLOPE = 0.05  # of the radius in the view over that in the photo
NEWTON_STEPS = 8


def radial_factor(r2, k1, k2):
    """Return the factor from photo to ideal points at a squared radius."""
    return 1 + r2 * (k1 + k2 * r2)


def newton_start(ideal, k1, k2):
    """Return the radius in the photo from which Newton's method never goes back and forth for good:
    where the lens's curve changes its bend, or else the ideal radius."""
    inflection = -0.3 * k1 / where(k2 == 0, 1.0, k2)  # squared radius
    bends = (k2 != 0) & (inflection > 0) & (inflection < 1)
    return where(bends, sqrt(where(bends, inflection, 1.0)), minimum(ideal, 1.0))


def newton_step(r, ideal, k1, k2):
    """Return a better radius that a lens takes to an ideal one, from 0 to the photo's corner, 1."""
    r2 = r * r
    error = r * (1 + r2 * (k1 + k2 * r2)) - ideal
    slope = maximum(1 + r2 * (3 * k1 + 5 * k2 * r2), MIN_LENS_SLOPE)
    return minimum(maximum(r - error / slope, 0.0), 1.0)


def tangent_radius(ideal, k1, k2):
    """Return the radius that the tangent in the photo's corners takes to an ideal one; only that
    beyond 1 is used: there the lens's curve may fold."""
    return 1 + (ideal - 1 - k1 - k2) / (1 + 3 * k1 + 5 * k2)


def project(x, y, h):
    """Return where a homography takes a point; h: from image to photo coordinates, too."""
    h00, h01, h02, h10, h11, h12, h20, h21, h22 = h
    nearness = 1 / maximum(h20 * x + h21 * y + h22, MIN_RAY_DEPTH)
    return (h00 * x + h01 * y + h02) * nearness, (h10 * x + h11 * y + h12) * nearness


def image_jacobian(u, v, lens, h):
    """Return the change of image x and y per photo pixel along u and v, as xu, xv, yu, yv."""
    radius_scale, k1, k2 = lens
    h00, h01, h02, h10, h11, h12, h20, h21, h22 = h
    r2 = radius_scale * (u * u + v * v)
    # the lens scales a point by a factor, which itself changes along the radius
    factor, along = 1 + r2 * (k1 + k2 * r2), 2 * radius_scale * (k1 + 2 * k2 * r2)
    uu, uv, vv = factor + along * u * u, along * u * v, factor + along * v * v
    p, q = u * factor, v * factor
    nearness = 1 / maximum(h20 * p + h21 * q + h22, MIN_RAY_DEPTH)
    x, y = (h00 * p + h01 * q + h02) * nearness, (h10 * p + h11 * q + h12) * nearness
    xp, xq = (h00 - x * h20) * nearness, (h01 - x * h21) * nearness
    yp, yq = (h10 - y * h20) * nearness, (h11 - y * h21) * nearness
    return xp * uu + xq * uv, xp * uv + xq * vv, yp * uu + yq * uv, yp * uv + yq * vv


def panel_jacobian(u, v, c):
    """Return the change of panel x and y per sensor pixel along u and v; c: an
    `exposure_records.Camera`."""
    h = c.h00, c.h01, c.h02, c.h10, c.h11, c.h12, c.h20, c.h21, c.h22
    xu, xv, yu, yv = image_jacobian(u, v, (c.radius_scale, c.k1, c.k2), h)
    by_u, by_v = c.alpha / c.scale_u, c.alpha / c.scale_v
    return by_u * xu, by_v * xv, by_u * yu, by_v * yv
