"""The kernels of exposing that Python calls: of a whole batch (`views_fit`, `beats_fit`), of one
image, or of some rows of one. The other modules' loops are compiled into them."""

from __future__ import annotations

import math

import numpy as np

from moireaug.camera.exposure.screen import EDGE_PIXELS
from moireaug.engine.cpu import beat_terms, beats, binned, full, panel, picture, point, stencil
from moireaug.engine.cpu.coarse_grid import can_follow_view, coarse_grid_of, no_coarse_grid
from moireaug.engine.cpu.compiling import jit, jit_inlined, kernel
from moireaug.engine.cpu.records import (
    BinnedSetup,
    Image,
    ImageBins,
    ImagePoints,
    Pattern,
    PixelView,
    Readout,
)
from moireaug.engine.lower.exposure_records import Camera, Cell, Sites

# limits of panels; the reference exposes what is beyond them
MAX_PANEL_PIXELS_PER_SENSOR_PIXEL = 16  # up to which building the panel pays off
MAX_SMALL_PANEL_PIXELS = 2**20  # which are never too many

# unpacking a row would need numba's unsafe to_fixed_tuple, which takes longer to compile
_COLUMNS = ", ".join(f"row[{i}]" for i in range(len(Camera._fields)))
# the Camera of a row of `Exposure.cameras`, whose columns are its fields
camera_of = jit(eval(f"lambda row: Camera({_COLUMNS})", {"Camera": Camera}))


@jit
def sites_of(sites, camera):
    """Return Sites whose rows and columns lie about the whole photo's centre; of a rectified
    camera, about that of the picture's frame."""
    return Sites(
        sites.rows + camera.centre_v, sites.cols + camera.centre_u, sites.step, sites.row,
        sites.col, sites.channel,
    )  # fmt: skip


@jit_inlined
def _pixel_view(camera, cell, view, i):
    """Return the PixelView of image i; view: a FullView."""
    blur_camera = camera_of(view.blur_cameras[i])
    return PixelView(camera, blur_camera, cell, view.widths[i], view.added_variance[i])


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
        pixel_view, sites = _pixel_view(camera, e.cell, view, i), sites_of(e.sites, camera)
        follows = can_follow_view(pixel_view, sites, e.dark_around, e.budget)
        out[i] = h * w <= most and follows
    return out


@jit_inlined
def panel_of(shown, camera, e):
    """Return the part of shown that a picture takes as the panel shows it, (3, h, w)."""
    h, w = panel.shape(e.size, camera, e.cell)
    return shown[: 3 * h * w].reshape(3, h, w)


@jit_inlined
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


@jit_inlined
def _image(e, i, camera, cell, grid, sites, bins, points):
    """Return the Image i; the rest are its fields."""
    height, width = (
        camera.alpha * e.size[0] + camera.lead_y,
        camera.alpha * e.size[1] + camera.lead_x,
    )
    read_noise, photons = np.float32(camera.dark_noise), np.float32(camera.photon_noise)
    keys = np.uint32(e.keys[i, 0]), np.uint32(e.keys[i, 1])
    return Image(
        camera, (math.ceil(height), math.ceil(width)), cell, grid, sites, e.filters[i], e.white[i],
        e.flicker[i], Readout(e.noisy, read_noise, photons, keys, e.clips), bins, points,
    )  # fmt: skip


@kernel
def full_grid_kernel(e, view, i):
    """Return the CoarseGrid of image i; view: a FullView."""
    pixel_view = _pixel_view(camera_of(e.cameras[i]), e.cell, view, i)
    return coarse_grid_of(pixel_view, view.coefficients[i], e.sites, e.budget)


@jit_inlined
def full_image(e, grid, i):
    """Return the Image i of a full reading; grid: from `full_grid_kernel`."""
    return _image(e, i, camera_of(e.cameras[i]), e.cell, grid, e.sites, None, None)


@kernel
def expose_full_kernel(raw, slopes, shown, e, view, grid, span):
    """Fill a part of raw (B, planes, h, w) float32 with the reading of a picture, from what
    `show_kernel` filled shown with.

    slopes: (B, planes, h, w or 0) float32, see `full.expose_rows`. view: a FullView. grid:
    from `full_grid_kernel`. span: a `records.Span`.
    """
    image = full_image(e, grid, span.i)
    shown_panel = panel_of(shown, image.camera, e)
    work = full.work_of_pixels(raw.shape[3], raw.shape[1], image)
    given = shown_panel, image, work, span.top, span.bottom
    full.expose_rows(raw[span.i], slopes[span.i], *given)


@jit_inlined
def _grid_and_stencil(camera, sensor, cell, sites, e, view, i):
    """Return the CoarseGrid and the BinStencil of image i of a binned reading, one of which is
    empty; view: of the picture, a FullView."""
    pixel_view = _pixel_view(camera, cell, view, i)
    # bins that are the image's pixels, on a panel that shows no fewer
    if sensor.rectified != 0 and camera.alpha == 1:
        return no_coarse_grid(len(cell.period)), stencil.stencil_of(pixel_view, sites, e.budget)
    grid = coarse_grid_of(pixel_view, view.coefficients[i], sites, e.budget)
    return grid, stencil.no_stencil()


@jit_inlined
def _cell_of(cell, centre):
    """Return a Cell with the centres of one image."""
    return Cell(
        cell.common_period, cell.period, cell.orders, cell.channel, cell.subpixel_kind,
        cell.y_group, cell.kind_y_group, centre, cell.pixel, cell.radius,
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
def binned_setup_kernel(e, view, i):
    """Return the BinnedSetup of image i; view: a BinnedView."""
    camera, sensor = camera_of(e.cameras[i]), camera_of(view.beats.cameras[i])
    cell = _cell_of(e.cell, view.beats.centres[i])
    sites = sites_of(e.sites, camera)
    grid, bin_stencil = _grid_and_stencil(camera, sensor, cell, sites, e, view.picture, i)
    terms = beats.beat_terms_of(view.beats, i, sensor, e.filters[i], sites, e.budget)
    return BinnedSetup(grid, bin_stencil, terms)


@jit_inlined
def binned_image(e, view, setup, i):
    """Return the Image i; view: a BinnedView. setup: from `binned_setup_kernel`."""
    b, camera = view.beats, camera_of(e.cameras[i])
    pattern = Pattern(b.coefficients[i], b.mean[i], b.lost_noise_variance[i], b.saturates)
    bins = ImageBins(camera_of(b.cameras[i]), setup.stencil, setup.terms, pattern)
    cell, sites = _cell_of(e.cell, b.centres[i]), sites_of(e.sites, camera)
    return _image(e, i, camera, cell, setup.grid, sites, bins, None)


@kernel
def expose_binned_kernel(raw, slopes, shown, e, view, setup, span):
    """Do the same as `expose_full_kernel` for a binned reading; view: a BinnedView. setup: from
    `binned_setup_kernel`."""
    image = binned_image(e, view, setup, span.i)
    shown_panel = panel_of(shown, image.camera, e)
    work = binned.work_of_bins(raw.shape[3], raw.shape[1], image)
    given = shown_panel, image, work, span.top, span.bottom
    binned.expose_rows(raw[span.i], slopes[span.i], *given)


@jit_inlined
def point_image(e, view, i):
    """Return the Image i; view: a PointView."""
    points = ImagePoints(e.size, view.rectangles, view.raster, view.lit[i], e.dark_around)
    return _image(e, i, camera_of(e.cameras[i]), e.cell, None, e.sites, None, points)


@kernel
def expose_point_kernel(raw, slopes, shown, e, view, setup, span):
    """Do the same as `expose_full_kernel` for a reading at points of the panel; view: a PointView.
    setup: None."""
    image = point_image(e, view, span.i)
    points = points_of(shown, image.camera.alpha, e)
    work = point.work_of_points(raw.shape[3], image)
    given = points, image, work, span.top, span.bottom
    point.expose_rows(raw[span.i], slopes[span.i], *given)
