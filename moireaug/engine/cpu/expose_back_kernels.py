"""The kernels of the gradient in pictures, each on some of a batch's images: those of
`expose_kernels`, transposed."""

from __future__ import annotations

import numpy as np

from moireaug.engine.cpu import binned_back, full_back, panel_back, picture, point_back
from moireaug.engine.cpu.compiling import fill, kernel, part
from moireaug.engine.cpu.expose_kernels import (
    binned_image,
    camera_of,
    full_image,
    panel_of,
    point_image,
)

ZERO = np.float32(0)


@part
def _picture_back(grad, light_grad, pictures, e, i):
    """Fill grad (3, H, W) with the gradient in picture i, from that in its light."""
    picture.fill_light_back(
        grad, light_grad, pictures[i], e.coded, e.black[i], e.neighbour_share[i]
    )


@kernel
def show_back_kernel(grads, shown_grads, light_grad, pictures, e, first, last):
    """Fill the gradients from `first` to `last` in pictures (B, 3, H, W) float32, from those in
    what `show_kernel` fills; arguments as there. shown_grads is written to."""
    for i in range(first, last):
        alpha = camera_of(e.cameras[i]).alpha
        panel_grad = panel_of(shown_grads[i - first], alpha, e)
        panel_back.fill_panel_back(light_grad, panel_grad, alpha, e.cell, e.dark)
        _picture_back(grads[i], light_grad, pictures, e, i)


@kernel
def expose_full_back_kernel(shown_grads, raw_grads, slopes, e, view, first, last):
    """Fill the gradients from `first` to `last` in what `show_kernel` fills, from those in readings
    (B, planes, h, w); slopes: as `expose_full_kernel` filled them."""
    for i in range(first, last):
        image, shown_grad = full_image(e, view, i), shown_grads[i - first]
        fill(shown_grad, ZERO)
        panel_grad = panel_of(shown_grad, image.camera.alpha, e)
        full_back.expose_full_image_back(panel_grad, raw_grads[i], slopes[i], image)


@kernel
def expose_binned_back_kernel(shown_grads, raw_grads, slopes, e, view, first, last):
    """Do the same as `expose_full_back_kernel` for binned readings."""
    for i in range(first, last):
        image, shown_grad = binned_image(e, view, i), shown_grads[i - first]
        fill(shown_grad, ZERO)
        panel_grad = panel_of(shown_grad, image.camera.alpha, e)
        binned_back.expose_binned_image_back(panel_grad, raw_grads[i], slopes[i], image)


@kernel
def expose_point_back_kernel(grads, raw_grads, slopes, pictures, e, view, first, last):
    """Fill the gradients from `first` to `last` in pictures (B, 3, H, W) float32, from those in
    readings at points of the panel."""
    light_grad = np.empty((3, e.size[0], e.size[1]), np.float32)
    for i in range(first, last):
        image = point_image(e, view, i)
        point_back.expose_point_image_back(light_grad, raw_grads[i], slopes[i], image)
        _picture_back(grads[i], light_grad, pictures, e, i)
