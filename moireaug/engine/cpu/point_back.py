"""The gradient of a point exposure in what is shown, and in a picture's light: `point`
transposed."""

from __future__ import annotations

import numpy as np

from moireaug.camera.exposure.screen import EDGE_PIXELS
from moireaug.engine.cpu.compiling import copy, fill, jit_in_place, jit_inlined
from moireaug.engine.cpu.panel_back import shrink_back
from moireaug.engine.cpu.point import locate_points, see, shown_pixels
from moireaug.engine.cpu.sensor import attenuate, read_back

ZERO, ONE = np.float32(0), np.float32(1)
ONE32 = np.int32(1)


@jit_in_place
def _add_content_back(shown, grad, along_x, along_y, width, passed):
    """Add to shown the gradient in it, from that in a row of light (n,); arguments as in
    `point._add_content`."""
    across, left, fx = along_x
    down, top, fy = along_y
    for i in range(len(grad)):
        g = grad[i] * across[i] * down[i] * passed
        below = g * fy[i]
        above, f = g - below, fx[i]
        k = np.int32(np.int32(top[i] * width) + left[i])
        shown[np.uint32(k)] += above * (ONE - f)
        shown[np.uint32(np.int32(k + ONE32))] += above * f
        k = np.int32(k + width)
        shown[np.uint32(k)] += below * (ONE - f)
        shown[np.uint32(np.int32(k + ONE32))] += below * f


@jit_inlined
def fill_shown_back(light_grad, shown, alpha):
    """Fill light_grad (3, H, W) from the gradient in what `point.fill_shown` fills."""
    _, h, w = light_grad.shape
    height, width = shown_pixels(h, alpha), shown_pixels(w, alpha)
    for c in range(3):
        if alpha < 1:
            fill(light_grad[c].reshape(-1), ZERO)
            panel = shown[c, : height * width].reshape(height, width)
            shrink_back(light_grad[c], panel, alpha, 1, EDGE_PIXELS, EDGE_PIXELS)
        else:
            copy(light_grad[c].reshape(-1), shown[c])


@jit_in_place
def expose_rows_back(shown_grad, grad, slope, image, work):
    """Add the gradient in what `point.fill_shown` fills, from that in a reading (planes, h, w); the
    rest as in `point.expose_rows`."""
    planes, h, _ = grad.shape
    camera, sites = image.camera, image.sites
    line, width, step = work.light, np.int32(work.columns.size), sites.step
    for r in range(h * step):
        pulse = image.flicker[r] if len(image.flicker) > 0 else 1.0
        for plane in range(planes):
            if sites.row[plane] != r % step:
                continue
            locate_points(work, image, plane, sites.rows[r])
            read_back(line, grad[plane, r // step], slope[plane, r // step])
            attenuate(line, work.u, work.v, camera)
            for i in range(len(image.points.rectangles)):
                colour = image.cell.channel[i]
                passed = image.filters[sites.channel[plane], colour] * pulse
                if passed == 0:
                    continue
                see(work, image, i)
                lit = np.float32(image.points.lit * passed)
                _add_content_back(shown_grad[colour], line, work.along_x, work.along_y, width, lit)
