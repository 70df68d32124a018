"""The kernels of the gradient in pictures, each on one image: those of `expose_kernels`,
transposed."""

from __future__ import annotations

import numpy as np

from moireaug.engine.cpu import binned, expose_kernels, full, panel_back, picture, point, point_back
from moireaug.engine.cpu.compiling import fill, kernel

ZERO = np.float32(0)


@kernel
def show_back_kernel(grads, shown_grad, light_grad, pictures, e, at_points, i):
    """Fill the gradient in picture i of (B, 3, H, W) float32, from that in what `show_kernel`
    fills; arguments as there. shown_grad is written to."""
    camera = expose_kernels.camera_of(e.cameras[i])
    if at_points:
        points_grad = expose_kernels.points_of(shown_grad, camera.alpha, e)
        point_back.fill_shown_back(light_grad, points_grad, camera.alpha)
    else:
        panel_grad = expose_kernels.panel_of(shown_grad, camera, e)
        panel_back.fill_panel_back(light_grad, panel_grad, camera, e.cell, e.dark_around)
    black, neighbour_share = e.black[i], e.neighbour_share[i]
    picture.fill_light_back(grads[i], light_grad, pictures[i], e.coded, black, neighbour_share)


@kernel
def expose_full_back_kernel(shown_grad, raw_grads, slopes, e, view, grid, i):
    """Fill the gradient in what `show_kernel` fills, from that in reading i of (B, planes, h, w);
    slopes: as `expose_full_kernel` filled them, the rest as there."""
    image = expose_kernels.full_image(e, grid, i)
    fill(shown_grad, ZERO)
    panel_grad = expose_kernels.panel_of(shown_grad, image.camera, e)
    work = full.work_of_pixels(raw_grads.shape[3], raw_grads.shape[1], image)
    full.expose_rows_back(panel_grad, raw_grads[i], slopes[i], image, work)


@kernel
def expose_binned_back_kernel(shown_grad, raw_grads, slopes, e, view, setup, i):
    """Do the same as `expose_full_back_kernel` for a binned reading."""
    image = expose_kernels.binned_image(e, view, setup, i)
    fill(shown_grad, ZERO)
    panel_grad = expose_kernels.panel_of(shown_grad, image.camera, e)
    work = binned.work_of_bins(raw_grads.shape[3], raw_grads.shape[1], image)
    binned.expose_rows_back(panel_grad, raw_grads[i], slopes[i], image, work)


@kernel
def expose_point_back_kernel(shown_grad, raw_grads, slopes, e, view, setup, i):
    """Do the same as `expose_full_back_kernel` for a reading at points of the panel."""
    image = expose_kernels.point_image(e, view, i)
    fill(shown_grad, ZERO)
    points_grad = expose_kernels.points_of(shown_grad, image.camera.alpha, e)
    work = point.work_of_points(raw_grads.shape[3], image)
    point_back.expose_rows_back(points_grad, raw_grads[i], slopes[i], image, work)
