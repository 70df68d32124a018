"""The content of bins that are the image's own pixels. All look at the same place in their pixels,
so that their tap weights change only with the lens's blur, slowly over the photo."""

from __future__ import annotations

import numpy as np

from moireaug.camera.exposure.footprint import NEAREST_GUARD_SHARE
from moireaug.engine.cpu.coarse_grid import bracket, node_line, used_counts
from moireaug.engine.cpu.compiling import fill, jit, jit_in_place, jit_inlined
from moireaug.engine.cpu.panel import margin
from moireaug.engine.cpu.records import BinStencil
from moireaug.engine.cpu.vectors import load, store
from moireaug.engine.cpu.view import BOX, SIGMA, fill_blurs, light_from

ZERO = np.float32(0)
FUSED_TAPS = 3  # along each axis, of which no sum is kept in memory


@jit_inlined
def no_stencil():
    """Return the BinStencil of an image that has none."""
    return BinStencil(np.empty((0, 0), np.float32), 0, 1.0)


@jit_in_place
def _fill_tap_weights(out, blur, width, past, radius):
    """Fill out (n,) with the shares of a bin's light that come from its own pixel, in the middle,
    and `radius` to each side; see `tap_weights`.

    Args:
        blur: (2,), from `view.fill_blur`. width: of the pixel's light, in pixels.
        past: where the bin looks, from the middle of that light, in pixels.
    """
    half = len(out) // 2
    fill(out, 0.0)
    total = 0.0
    for k in range(-radius, radius + 1):
        light = light_from(abs(k - past), blur[BOX], blur[SIGMA], width)
        out[half + k] = light + NEAREST_GUARD_SHARE * blur[BOX] if k == 0 else light
        total += out[half + k]
    for k in range(len(out)):
        out[k] /= total


@jit_in_place
def _reach(weights, least):
    """Return how many pixels to each side anywhere weigh more than `least`, at least 1; weights:
    (n, pixels)."""
    half = weights.shape[1] // 2
    for reach in range(half, 1, -1):
        for i in range(len(weights)):
            if max(weights[i, half - reach], weights[i, half + reach]) > least:
                return reach
    return 1


@jit_in_place
def _trim(weights, reach):
    """Make the weights of pixels up to `reach` to each side sum to 1."""
    half = weights.shape[1] // 2
    for i in range(len(weights)):
        total = 0.0
        for k in range(half - reach, half + reach + 1):
            total += weights[i, k]
        for k in range(len(weights[i])):
            weights[i, k] /= total


@jit_in_place
def _columns(ends, node_share, cols, first, step):
    """Fill ends (nodes,) with the first bin past each node of a row, and node_share (w,) float32
    with how far each bin is towards the next node."""
    done = 0
    for i in range(len(cols)):
        node, t = bracket(cols[i], first, step, len(ends), 1)
        node_share[i] = t
        while done <= node:
            ends[done] = i
            done += 1
    for j in range(done, len(ends)):
        ends[j] = len(cols)


@jit_in_place
def _interpolate(out, share, low, high):
    """Fill out (n,) with values between two numbers; share: (n,), how far each is towards the
    second."""
    for i in range(len(out)):
        store(out, i, low + load(share, i) * (high - low))


@jit_in_place
def _fill_lines(lines, start, weights, tap, ends, node_share):
    """Fill lines (rows, ...) from `start` on with the weights of one pixel at each bin, from those
    at nodes (rows * columns, pixels); ends, node_share: from `_columns`."""
    columns = len(ends)
    for r in range(len(lines)):
        for c in range(columns - 1):
            low, high = ends[c], ends[c + 1]
            a, b = weights[r * columns + c, tap], weights[r * columns + c + 1, tap]
            line = lines[r, start + low : start + high]
            _interpolate(line, node_share[low:high], np.float32(a), np.float32(b))


@jit
def _tap_weights_at(us, vs, view):
    """Return the tap weights at nodes of the photo, (colours, axes, nodes, pixels) float64: at
    least a pixel to each side, without light if the cell's radius is 0."""
    cell, radius, nodes = view.cell, view.cell.radius, len(us) * len(vs)
    blur, out = np.empty((nodes, 2, 2)), np.empty((3, 2, nodes, 2 * max(radius, 1) + 1))
    for i in range(len(cell.channel)):
        colour, kind = cell.channel[i], cell.subpixel_kind[i]
        fill_blurs(blur, us, vs, view, kind)
        for axis in range(2):
            past = 0.5 - cell.centre[i, axis]  # no more than half a pixel
            for node in range(nodes):
                weights, width = out[colour, axis, node], view.widths[kind, axis]
                _fill_tap_weights(weights, blur[node, axis], width, past, radius)
    return out


@jit
def stencil_of(view, sites, budget):
    """Return the BinStencil of an image that has one; view: a PixelView. budget: an
    `ErrorBudget`."""
    count = used_counts(sites, view, budget)[1]
    us, step_u = node_line(sites.cols, count[0])
    vs, step_v = node_line(sites.rows, count[1])
    weights = _tap_weights_at(us, vs, view)
    table = weights.reshape(-1, weights.shape[3])
    half, reach = weights.shape[3] // 2, _reach(table, budget.tap_weight)
    _trim(table, reach)
    w, taps, done = len(sites.cols), 2 * reach + 1, 0
    ends, node_share = np.empty(len(us), np.int64), np.empty(w, np.float32)
    _columns(ends, node_share, sites.cols, us[0], step_u)
    lines = np.empty((len(vs), 6 * taps * w), np.float32)
    for colour in range(3):
        for axis in range(2):
            for tap in range(half - reach, half + reach + 1):
                _fill_lines(lines, done, weights[colour, axis], tap, ends, node_share)
                done += w
    return BinStencil(lines, taps, step_v)


@jit_in_place
def _interpolated(low, high, past):
    return low + past * (high - low)


@jit_in_place
def _three_by_three(out, low, high, past, pixels, start, stride):
    """Fill out (w,) with the content of 3 x 3 pixels.

    Args:
        low, high: (6 * w,), their weights on the rows of nodes above and below, mixed `past` of the
            way.
        pixels: flat. start: of the first bin's first. stride: from a row of them to the next.
    """
    w, second, third = len(out), start + stride, start + 2 * stride
    for i in range(w):
        a = _interpolated(load(low, i), load(high, i), past)
        b = _interpolated(load(low, i + w), load(high, i + w), past)
        c = _interpolated(load(low, i + 2 * w), load(high, i + 2 * w), past)
        d = _interpolated(load(low, i + 3 * w), load(high, i + 3 * w), past)
        e = _interpolated(load(low, i + 4 * w), load(high, i + 4 * w), past)
        f = _interpolated(load(low, i + 5 * w), load(high, i + 5 * w), past)
        at = start + i
        above = a * load(pixels, at) + b * load(pixels, at + 1) + c * load(pixels, at + 2)
        at = second + i
        here = a * load(pixels, at) + b * load(pixels, at + 1) + c * load(pixels, at + 2)
        at = third + i
        below = a * load(pixels, at) + b * load(pixels, at + 1) + c * load(pixels, at + 2)
        store(out, i, d * above + e * here + f * below)


@jit_in_place
def _add_weighed(out, low, high, past, values, start):
    """Add values (n,) from `start` on to out (w,), weighed as in `_three_by_three`."""
    for i in range(len(out)):
        weight = _interpolated(load(low, i), load(high, i), past)
        store(out, i, out[i] + weight * load(values, start + i))


@jit_in_place
def _square(out, line, low, high, past, pixels, start, stride):
    """Do the same as `_three_by_three` for more pixels; line: (w,) float32, workspace."""
    w = len(out)
    taps = len(low) // (2 * w)
    fill(out, ZERO)
    for j in range(taps):
        fill(line, ZERO)
        for i in range(taps):
            a, b = i * w, (i + 1) * w
            _add_weighed(line, low[a:b], high[a:b], past, pixels, start + j * stride + i)
        a, b = (taps + j) * w, (taps + j + 1) * w
        _add_weighed(out, low[a:b], high[a:b], past, line, 0)


@jit_in_place
def _locate(stencil, cell, sites, row, stride):
    """Return the row of nodes above a row of bins, how far these are towards the next one, float32,
    and the index of their first pixel on a flattened panel, whose rows lie `stride` apart."""
    node, t = bracket(sites.rows[row], sites.rows[0], stencil.step_v, len(stencil.lines), 1)
    reach = stencil.taps // 2
    start = (margin(cell, 1) + row - reach) * stride + margin(cell, 0) - reach
    return node, np.float32(t), start


@jit_in_place
def content(out, line, stencil, panel, cell, sites, row):
    """Fill out (3, w) with what a row of bins sees of the picture.

    Args:
        line: (w,) float32, workspace. panel: (3, ...) float32, from `panel.fill_panel`.
    """
    stride, size = panel.shape[2], 2 * stencil.taps * out.shape[1]
    node, past, start = _locate(stencil, cell, sites, row, stride)
    above, below = stencil.lines[node], stencil.lines[node + 1]
    flat = panel.reshape(3, panel.shape[1] * stride)
    for colour in range(3):
        a, b = colour * size, (colour + 1) * size
        if stencil.taps == FUSED_TAPS:
            _three_by_three(out[colour], above[a:b], below[a:b], past, flat[colour], start, stride)
        else:
            _square(out[colour], line, above[a:b], below[a:b], past, flat[colour], start, stride)


@jit_in_place
def content_back(panel_grad, grad, line, stencil, cell, sites, row):
    """Add the gradient in the panel, of its shape, from that in the content of a row of bins, grad
    (3, w); the rest as in `content`."""
    w, taps, stride = grad.shape[1], stencil.taps, panel_grad.shape[2]
    node, past, start = _locate(stencil, cell, sites, row, stride)
    above, below = stencil.lines[node], stencil.lines[node + 1]
    flat = panel_grad.reshape(3, panel_grad.shape[1] * stride)
    for colour in range(3):
        offset = colour * 2 * taps * w
        for j in range(taps):
            fill(line, ZERO)
            a, b = offset + (taps + j) * w, offset + (taps + j + 1) * w
            _add_weighed(line, above[a:b], below[a:b], past, grad[colour], 0)
            for i in range(taps):
                a, b, at = offset + i * w, offset + (i + 1) * w, start + j * stride + i
                pixels = flat[colour, at : at + w]
                _add_weighed(pixels, above[a:b], below[a:b], past, line, 0)


@jit_in_place
def look_straight(x, y, row):
    """Fill x, y (n,) with the panel coordinates that a row of bins sees."""
    for i in range(len(x)):
        x[i], y[i] = i + 0.5, row + 0.5
