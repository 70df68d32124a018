"""The kernels of exposing that Python calls: of a whole batch (`views_fit`, `beats_fit`), of one
image, or of some rows of one. The other modules' loops are compiled into them."""

from __future__ import annotations

import math

import numpy as np

from moireaug.camera.exposure.displayed import EDGE_PIXELS
from moireaug.engine.cpu import beat_terms, beats, panel, picture, point, stencil
from moireaug.engine.cpu.binned import expose_binned_image
from moireaug.engine.cpu.compiling import kernel, loop, part
from moireaug.engine.cpu.full import expose_full_image
from moireaug.engine.cpu.limits import MAX_PANEL_PIXELS_PER_SENSOR_PIXEL, MAX_SMALL_PANEL_PIXELS
from moireaug.engine.cpu.nodes import can_follow_view, no_nodes, nodes_of
from moireaug.engine.cpu.point import expose_point_image
from moireaug.engine.cpu.records import (
    BinnedImage,
    BinnedSetup,
    FullImage,
    Pattern,
    PointImage,
    Readout,
)
from moireaug.engine.lower.exposure_records import Camera, Cell, Sites


@loop
def camera_of(row):
    """Return the Camera of a row of `Exposure.cameras`, whose columns are its fields."""
    # unpacking it would need numba's unsafe to_fixed_tuple, which takes longer to compile
    return Camera(
        row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8], row[9], row[10],
        row[11], row[12], row[13], row[14], row[15], row[16], row[17], row[18], row[19], row[20],
        row[21], row[22], row[23], row[24], row[25], row[26], row[27], row[28], row[29], row[30],
        row[31], row[32], row[33], row[34], row[35], row[36], row[37],
    )  # fmt: skip


@loop
def sites_of(sites, camera):
    """Return Sites whose rows and columns lie about the whole photo's centre; of a rectified
    camera, about that of the picture's frame."""
    return Sites(
        sites.rows + camera.centre_v, sites.cols + camera.centre_u, sites.step, sites.row,
        sites.col, sites.channel,
    )  # fmt: skip


@kernel
def views_fit(e, view):
    """Return for each image whether the kernels can follow its view, (B,) bool.

    e: see `exposure_records.Exposure`. view: a FullView.

    The reference takes views near the horizon, and panels of far more pixels than the sensor.
    """
    out = np.empty(len(e.cameras), np.bool_)
    most = MAX_PANEL_PIXELS_PER_SENSOR_PIXEL * len(e.sites.rows) * len(e.sites.cols)
    most = max(most, MAX_SMALL_PANEL_PIXELS)
    for i in range(len(out)):
        camera = camera_of(e.cameras[i])
        h, w = panel.shape(e.size, camera, e.cell)
        out[i] = h * w <= most and can_follow_view(
            camera,
            camera_of(view.blur_cameras[i]),
            e.cell,
            view.widths[i],
            view.added_variance[i],
            sites_of(e.sites, camera),
            e.dark_around,
            e.budget,
        )
    return out


@part
def panel_of(shown, camera, e):
    """Return the part of shown that a picture takes as the panel shows it, (3, h, w)."""
    h, w = panel.shape(e.size, camera, e.cell)
    return shown[: 3 * h * w].reshape(3, h, w)


@part
def points_of(shown, alpha, e):
    """Return the part of shown that a picture takes as points see it, (3, n)."""
    height, width = point.shown_pixels(e.size[0], alpha), point.shown_pixels(e.size[1], alpha)
    n = point.shown_values(height, width)
    return shown[: 3 * n].reshape(3, n)


def shown_length(e, at_points) -> int:
    """Return how many values `show_kernel` fills at most."""
    if at_points:
        h, w = e.size[0] + 2 * EDGE_PIXELS, e.size[1] + 2 * EDGE_PIXELS
        return 3 * point.shown_values.py_func(h, w)
    h, w = panel.shape.py_func(e.size, Camera(*e.cameras.max(0)), e.cell)
    return int(3 * h * w)


@kernel
def show_kernel(shown, light, pictures, e, at_points, i):
    """Fill shown with picture i as the panel shows it, or as points of it see it.

    Args:
        shown: (`shown_length`(e, at_points),) float32. light: (3, H, W) float32, workspace.
        pictures: (B, 3, H, W) float32 or uint8.
        e: see `exposure_records.Exposure`.
    """
    camera = camera_of(e.cameras[i])
    picture.fill_light(light, pictures[i], e.coded, e.black[i], e.neighbour_share[i])
    if at_points:
        point.fill_shown(points_of(shown, camera.alpha, e), light, camera.alpha)
    else:
        panel.fill_panel(panel_of(shown, camera, e), light, camera, e.cell, e.dark_around)


@part
def _nodes(camera, cell, sites, e, view, i):
    """Return the Nodes of image i; view: a FullView."""
    blur_camera = camera_of(view.blur_cameras[i])
    widths, added_variance = view.widths[i], view.added_variance[i]
    return nodes_of(
        camera, blur_camera, cell, view.coefficients[i], widths, added_variance, sites, e.budget
    )


@part
def _readout(camera, e, i):
    """Return the Readout of image i."""
    read_noise, photons = np.float32(camera.dark_noise), np.float32(camera.photon_noise)
    keys = np.uint32(e.keys[i, 0]), np.uint32(e.keys[i, 1])
    return Readout(e.noisy, read_noise, photons, keys, e.clips)


@part
def _size_on_panel(camera, e):
    """Return the height and width of a picture on the panel, with what leads it, rounded up."""
    return (
        math.ceil(camera.alpha * e.size[0] + camera.lead_y),
        math.ceil(camera.alpha * e.size[1] + camera.lead_x),
    )


@kernel
def full_nodes_kernel(e, view, i):
    """Return the Nodes of image i; view: a FullView."""
    return _nodes(camera_of(e.cameras[i]), e.cell, e.sites, e, view, i)


@part
def full_image(e, nodes, i):
    """Return the FullImage of image i; nodes: from `full_nodes_kernel`."""
    camera = camera_of(e.cameras[i])
    return FullImage(
        camera, _size_on_panel(camera, e), e.cell, nodes, e.sites, e.filters[i], e.white[i],
        e.flicker[i], _readout(camera, e, i),
    )  # fmt: skip


@kernel
def expose_full_kernel(raw, slopes, shown, e, view, nodes, span):
    """Fill a part of raw (B, planes, h, w) float32 with the reading of a picture, from what
    `show_kernel` filled shown with.

    slopes: (B, planes, h, w or 0) float32, see `full.expose_full_image`. view: a FullView. nodes:
    from `full_nodes_kernel`. span: a `records.Span`.
    """
    image = full_image(e, nodes, span.i)
    shown_panel = panel_of(shown, image.camera, e)
    expose_full_image(raw[span.i], slopes[span.i], shown_panel, image, span.top, span.bottom)


@part
def _nodes_and_stencil(camera, sensor, cell, sites, e, view, i):
    """Return the Nodes and the BinStencil of image i of a binned reading: one of them is empty;
    view: of the picture, a FullView."""
    if not stencil.has_stencil(camera, sensor):
        return _nodes(camera, cell, sites, e, view, i), stencil.no_stencil()
    none, blur_camera = no_nodes(len(view.widths[i])), camera_of(view.blur_cameras[i])
    return none, stencil.stencil_of(
        camera, blur_camera, cell, view.widths[i], view.added_variance[i], sites, e.budget
    )


@part
def _cell_of(cell, centre):
    """Return a Cell with the centres of one image."""
    return Cell(
        cell.whole, cell.period, cell.orders, cell.channel, cell.kind, cell.y_group,
        cell.kind_y_group, centre, cell.pixel, cell.radius,
    )  # fmt: skip


@kernel
def beats_fit(e, b):
    """Return for each image whether `expose_binned_kernel` can follow its beats, (B,) bool."""
    out = np.empty(len(b.cameras), np.bool_)
    for i in range(len(out)):
        camera = camera_of(b.cameras[i])
        out[i] = beat_terms.can_follow_beats(sites_of(e.sites, camera), camera, b, i, e.budget)
    return out


@kernel
def binned_nodes_kernel(e, view, i):
    """Return the BinnedSetup of image i; view: a BinnedView."""
    camera, sensor = camera_of(e.cameras[i]), camera_of(view.beats.cameras[i])
    cell = _cell_of(e.cell, view.beats.centres[i])
    sites = sites_of(e.sites, camera)
    nodes, bin_stencil = _nodes_and_stencil(camera, sensor, cell, sites, e, view.picture, i)
    terms = beats.beat_terms_of(view.beats, i, sensor, e.filters[i], sites, e.budget)
    return BinnedSetup(nodes, bin_stencil, terms)


@part
def binned_image(e, view, setup, i):
    """Return the BinnedImage of image i; view: a BinnedView. setup: from `binned_nodes_kernel`."""
    b, camera = view.beats, camera_of(e.cameras[i])
    pattern = Pattern(b.coefficients[i], b.mean[i], b.lost_noise_variance[i], b.saturates, b.bayer)
    return BinnedImage(
        camera, camera_of(b.cameras[i]), _size_on_panel(camera, e),
        _cell_of(e.cell, b.centres[i]), setup.nodes, setup.stencil, sites_of(e.sites, camera),
        setup.terms, pattern, e.filters[i], e.white[i], e.flicker[i], _readout(camera, e, i),
    )  # fmt: skip


@kernel
def expose_binned_kernel(raw, slopes, shown, e, view, setup, span):
    """Do the same as `expose_full_kernel` for a binned reading; view: a BinnedView. setup: from
    `binned_nodes_kernel`."""
    image = binned_image(e, view, setup, span.i)
    shown_panel = panel_of(shown, image.camera, e)
    expose_binned_image(raw[span.i], slopes[span.i], shown_panel, image, span.top, span.bottom)


@part
def point_image(e, view, i):
    """Return the PointImage of image i; view: a PointView."""
    camera = camera_of(e.cameras[i])
    return PointImage(
        camera, e.size, e.cell, view, view.lit[i], e.sites,
        e.filters[i], e.white[i], e.flicker[i], _readout(camera, e, i), e.dark_around,
    )  # fmt: skip


@kernel
def expose_point_kernel(raw, slopes, shown, e, view, nodes, span):
    """Do the same as `expose_full_kernel` for a reading at points of the panel; view: a PointView.
    nodes: None."""
    image = point_image(e, view, span.i)
    points = points_of(shown, image.camera.alpha, e)
    expose_point_image(raw[span.i], slopes[span.i], points, image, span.top, span.bottom)
