"""The kernels of the gradient in pictures, each on some of a batch's images: those of
`batch_expose`, transposed."""

from __future__ import annotations

import numpy as np

from moireaug.engine.cpu import binned_back, expose_back, panel_back, picture, point_back
from moireaug.engine.cpu.batch_expose import (
    binned_image,
    camera_of,
    full_image,
    panel_of,
    point_image,
    size_in_panel_pixels,
)
from moireaug.engine.cpu.compiling import fill, kernel, part

ZERO = np.float32(0)


@part
def _picture_back(grad, light_grad, pictures, e, i):
    """Fill grad (3, H, W) with the gradient in picture i, from that in its light."""
    picture.fill_light_back(
        grad, light_grad, pictures[i], e.coded, e.black[i], e.neighbour_share[i]
    )


@kernel
def show_back(grads, shown_grads, light_grad, pictures, e, first, last):
    """Fill the gradients from `first` to `last` in pictures (B, 3, H, W) float32, from those in
    what `batch_expose.show` fills; arguments as there. shown_grads is written to."""
    for i in range(first, last):
        alpha = camera_of(e.cameras[i]).alpha
        panel_grad = panel_of(shown_grads[i - first], alpha, e)
        panel_back.fill_panel_back(light_grad, panel_grad, alpha, e.cell, e.dark)
        _picture_back(grads[i], light_grad, pictures, e, i)


@kernel
def expose_full_back(shown_grads, raw_grads, slopes, e, first, last):
    """Fill the gradients from `first` to `last` in what `batch_expose.show` fills, from those in
    readings (B, planes, h, w); slopes: as `batch_expose.expose` filled them."""
    for i in range(first, last):
        alpha, shown_grad = camera_of(e.cameras[i]).alpha, shown_grads[i - first]
        fill(shown_grad, ZERO)
        panel_grad, size = panel_of(shown_grad, alpha, e), size_in_panel_pixels(alpha, e)
        expose_back.expose_back(panel_grad, raw_grads[i], slopes[i], size, full_image(e, i))


@kernel
def expose_binned_back(shown_grads, raw_grads, slopes, e, b, first, last):
    """Do the same as `expose_full_back` for binned readings."""
    for i in range(first, last):
        alpha, shown_grad = camera_of(e.cameras[i]).alpha, shown_grads[i - first]
        fill(shown_grad, ZERO)
        panel_grad, size = panel_of(shown_grad, alpha, e), size_in_panel_pixels(alpha, e)
        binned_back.expose_back(panel_grad, raw_grads[i], slopes[i], size, binned_image(e, b, i))


@kernel
def expose_points_back(grads, light_grad, raw_grads, slopes, pictures, e, first, last):
    """Fill the gradients from `first` to `last` in pictures (B, 3, H, W) float32, from those in
    readings at points of the panel; light_grad: (3, H, W) float32, workspace."""
    for i in range(first, last):
        point_back.expose_point_back(light_grad, raw_grads[i], slopes[i], point_image(e, i))
        _picture_back(grads[i], light_grad, pictures, e, i)
