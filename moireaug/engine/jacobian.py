"""How panel coordinates change over a photo: in numpy for all points and cameras of a batch, and
compiled by numba for one of each."""

from __future__ import annotations

from typing import Any

import numpy as np

from moireaug.scene.geometry.frame import MIN_RAY_DEPTH


def panel_jacobian(u: Any, v: Any, c: Any) -> tuple[Any, Any, Any, Any]:
    """Return the change of panel x and y per sensor pixel along u and v, as xu, xv, yu, yv, at
    photo points about the centre.

    c: an `exposure_records.Camera`, of numbers or of arrays that broadcast over the points.
    """
    r2 = c.radius_scale * (u * u + v * v)
    lens_factor, along = 1 + r2 * (c.k1 + c.k2 * r2), 2 * c.radius_scale * (c.k1 + 2 * c.k2 * r2)
    uu, uv, vv = lens_factor + along * u * u, along * u * v, lens_factor + along * v * v
    p, q = u * lens_factor, v * lens_factor
    nearness = 1 / np.maximum(c.h20 * p + c.h21 * q + c.h22, MIN_RAY_DEPTH)
    x, y = (c.h00 * p + c.h01 * q + c.h02) * nearness, (c.h10 * p + c.h11 * q + c.h12) * nearness
    xp, xq = (c.h00 - x * c.h20) * nearness, (c.h01 - x * c.h21) * nearness
    yp, yq = (c.h10 - y * c.h20) * nearness, (c.h11 - y * c.h21) * nearness
    by_u, by_v = c.alpha / c.scale_u, c.alpha / c.scale_v
    return (
        by_u * (xp * uu + xq * uv),
        by_v * (xp * uv + xq * vv),
        by_u * (yp * uu + yq * uv),
        by_v * (yp * uv + yq * vv),
    )
