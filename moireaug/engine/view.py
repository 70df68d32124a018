"""Where a sensor pixel looks, and the Jacobian there, in float64."""

from __future__ import annotations

from moireaug.engine.compiling import inner
from moireaug.engine.vectors import peek, poke
from moireaug.geometry.grids import NEAR_HORIZON


@inner
def look(x, y, cols, v, camera):
    """Fill x, y (n,) with the panel coordinates that a row v of photo columns sees, v and cols
    about the centre."""
    c = camera
    b = c.bend * v * v
    c0, c1, c2 = 1 + b * (c.k1 + c.k2 * b), c.bend * (c.k1 + 2 * c.k2 * b), c.bend * c.bend * c.k2
    ax, bx, dx = c.alpha * c.h00, c.alpha * c.h01 * v, c.alpha * c.h02
    ay, by, dy = c.alpha * c.h10, c.alpha * c.h11 * v, c.alpha * c.h12
    az, bz, dz = c.h20, c.h21 * v, c.h22
    for i in range(len(x)):
        u = peek(cols, i)
        a = u * u
        bent = c0 + a * (c1 + a * c2)
        far = 1 / max((az * u + bz) * bent + dz, NEAR_HORIZON)
        poke(x, i, ((ax * u + bx) * bent + dx) * far)
        poke(y, i, ((ay * u + by) * bent + dy) * far)


@inner
def jacobian(u, v, camera):
    """Return d(panel x, y) / d(sensor pixel u, v), as xu, xv, yu, yv, at a photo point about the
    centre."""
    c = camera
    r2 = c.bend * (u * u + v * v)
    bent, along = 1 + r2 * (c.k1 + c.k2 * r2), 2 * c.bend * (c.k1 + 2 * c.k2 * r2)
    uu, uv, vv = bent + along * u * u, along * u * v, bent + along * v * v
    p, q = u * bent, v * bent
    far = 1 / max(c.h20 * p + c.h21 * q + c.h22, NEAR_HORIZON)
    x, y = (c.h00 * p + c.h01 * q + c.h02) * far, (c.h10 * p + c.h11 * q + c.h12) * far
    xp, xq = (c.h00 - x * c.h20) * far, (c.h01 - x * c.h21) * far
    yp, yq = (c.h10 - y * c.h20) * far, (c.h11 - y * c.h21) * far
    by_u, by_v = c.alpha / c.scale_u, c.alpha / c.scale_v
    return (
        by_u * (xp * uu + xq * uv),
        by_v * (xp * uv + xq * vv),
        by_u * (yp * uu + yq * uv),
        by_v * (yp * uv + yq * vv),
    )
