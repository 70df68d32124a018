"""The gradient in a picture's light, from that in what the panel shows: `panel.fill_panel`
transposed."""

from __future__ import annotations

import numpy as np

from moireaug.engine.cpu import panel as showing
from moireaug.engine.cpu.compiling import fill, jit, jit_in_place, jit_inlined
from moireaug.engine.cpu.vectors import add

ZERO, ONE = np.float32(0), np.float32(1)
ONE32 = np.int32(1)


@jit_in_place
def _interpolate_row_back(row, grad, first, share):
    """Add to a row the gradient in it, from that in what is interpolated between its pixels. A
    pixel past the last, where the share is 0, is the last."""
    last = np.int32(len(row) - 1)
    for i in range(len(grad)):
        x, second = first[i], share[i] * grad[i]
        row[np.uint32(x)] += grad[i] - second
        row[np.uint32(min(np.int32(x + ONE32), last))] += second


@jit
def _enlarge_back(light, panel, alpha, period, ahead, above):
    """Add to the light of one colour (h, w) the gradient in it, from that in its panel (n, m)."""
    (h, w), (n, m) = light.shape, panel.shape
    y, fy = showing.interpolated_pixels(n, h, alpha, 1, above)
    x, fx = showing.interpolated_pixels(m, w, alpha, period, ahead)
    # the gradient in two rows of light that are as wide as the panel: it is narrowed once for each
    lines = np.zeros((2, m), np.float32)
    here = 0
    for i in range(n):
        while here < y[i]:
            _interpolate_row_back(light[here], lines[here % 2], x, fx)
            fill(lines[here % 2], ZERO)
            here += 1
        add(lines[here % 2], panel[i], ONE - fy[i])
        add(lines[min(here + 1, h - 1) % 2], panel[i], fy[i])
    for last in range(here, min(here + 2, h)):
        _interpolate_row_back(light[last], lines[last % 2], x, fx)


@jit_in_place
def _add_across_back(row, grad, pixel, weight):
    for i in range(len(grad)):
        row[np.uint32(pixel[i])] += weight[i] * grad[i]


@jit
def shrink_back(light, panel, alpha, period, ahead, above):
    """Add to the light of one colour (h, w) the gradient in it, from that in a panel (n, m) of
    fewer pixels; the rest as in `panel.shrink`."""
    (h, w), (n, m) = light.shape, panel.shape
    x, across = showing.averaged_pixels(m, w, alpha, period, ahead)
    y, down = showing.averaged_pixels(n, h, alpha, 1, above)
    row = np.empty(w, np.float32)
    for i in range(n):
        fill(row, ZERO)
        for tap in range(len(x)):
            _add_across_back(row, panel[i], x[tap], across[tap])
        for tap in range(len(x)):
            if down[tap, i] != 0:
                add(light[y[tap, i]], row, down[tap, i])


@jit
def _surround_back(light, panel, ahead, above):
    """Add to the light of one colour (h, w) the gradient in it, from that in the panel around
    it."""
    h, w = light.shape
    for i in range(len(panel)):
        row, shown = light[min(max(i - above, 0), h - 1)], panel[i]
        add(row, shown[ahead : ahead + w], ONE)
        for j in range(ahead):
            row[0] += shown[j]
        for j in range(ahead + w, len(shown)):
            row[w - 1] += shown[j]


@jit_inlined
def fill_panel_back(light_grad, panel_grad, camera, cell, dark_around):
    """Fill light_grad (3, H, W) with the gradient in a picture's light, from that in its panel,
    which is written to; arguments as in `panel.fill_panel`."""
    ahead, above, alpha = showing.margin(cell, 0), showing.margin(cell, 1), camera.alpha
    fill(light_grad.reshape(-1), ZERO)
    for c in range(3):
        period = showing.period_of(cell, c)
        if dark_around:
            showing.blacken(panel_grad[c], light_grad.shape[1:], alpha, period, ahead, above)
        if alpha < 1:
            lead_x, lead_y = ahead + camera.lead_x, above + camera.lead_y
            shrink_back(light_grad[c], panel_grad[c], alpha, period, lead_x, lead_y)
        elif alpha == 1 and period == 1:
            _surround_back(light_grad[c], panel_grad[c], ahead, above)
        else:
            _enlarge_back(light_grad[c], panel_grad[c], alpha, period, ahead, above)
