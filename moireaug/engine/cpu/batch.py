"""The kernels that Python calls, each on some of a batch's images, or on some rows of one. The
other modules' loops are compiled into them."""

from __future__ import annotations

import math

import numpy as np

from moireaug.engine.budget import MAX_PANEL_PIXELS_PER_SENSOR_PIXEL, MAX_SMALL_PANEL_PIXELS
from moireaug.engine.cpu import beat_terms, beats, finish, nodes, panel, picture, stencil
from moireaug.engine.cpu.binned import expose as expose_bins
from moireaug.engine.cpu.compiling import fill, kernel, loop, part
from moireaug.engine.cpu.develop import develop as develop_image
from moireaug.engine.cpu.develop_back import develop_back as develop_image_back
from moireaug.engine.cpu.expose import expose as expose_image
from moireaug.engine.cpu.point import expose_point
from moireaug.engine.cpu.random_numbers import keys
from moireaug.engine.cpu.records import BinnedImage, FullImage, Pattern, PointImage, Readout
from moireaug.engine.cpu.register import flat_length, register, register_back, rows_read
from moireaug.engine.exposure_records import Camera, Cell

ZERO = np.float32(0)


@loop
def _camera(row):
    """Return the Camera of a row of `Exposure.cameras`, whose columns are its fields."""
    # unpacking it would need numba's unsafe to_fixed_tuple, which takes longer to compile
    return Camera(
        row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8], row[9], row[10],
        row[11], row[12], row[13], row[14], row[15], row[16], row[17], row[18], row[19], row[20],
        row[21], row[22], row[23], row[24], row[25], row[26], row[27],
    )  # fmt: skip


@kernel
def views_fit(e):
    """Return for each image whether `expose` can follow its view, (B,) bool; e: see
    `exposure_records.Exposure`.

    The reference takes views near the horizon, and panels of far more pixels than the sensor.
    """
    out = np.empty(len(e.cameras), np.bool_)
    most = MAX_PANEL_PIXELS_PER_SENSOR_PIXEL * len(e.sites.rows) * len(e.sites.cols)
    most = max(most, MAX_SMALL_PANEL_PIXELS)
    for i in range(len(out)):
        camera = _camera(e.cameras[i])
        h, w = panel.shape(e.size, camera.alpha, e.cell)
        out[i] = h * w <= most and nodes.can_follow_view(
            camera,
            _camera(e.lenses[i]),
            e.cell,
            e.widths[i],
            e.added_variance[i],
            e.sites,
            e.dark,
            e.budget,
        )
    return out


@part
def _light(light, pictures, e, i):
    """Fill light (3, H, W) float32 from picture i."""
    picture.fill_light(light, pictures[i], e.coded, e.black[i], e.neighbour_share[i])


@part
def _panel(shown, alpha, e):
    """Return the part of shown that a picture takes as the panel shows it, (3, h, w)."""
    h, w = panel.shape(e.size, alpha, e.cell)
    return shown[: 3 * h * w].reshape(3, h, w)


def panel_size(e) -> int:
    """Return how many values the largest picture takes as the panel shows it."""
    alpha = e.cameras[:, Camera._fields.index("alpha")].max()
    h, w = panel.shape.py_func(e.size, alpha, e.cell)
    return int(3 * h * w)


@kernel
def show(shown, light, pictures, e, first, last):
    """Fill shown with the pictures from `first` to `last` as the panel shows them.

    Args:
        shown: (last - first, `panel_size`(e)) float32, or more rows. light: (3, H, W) float32,
            workspace.
        pictures: (B, 3, H, W) float32 or uint8.
        e: see `exposure_records.Exposure`.
    """
    for i in range(first, last):
        alpha = _camera(e.cameras[i]).alpha
        _light(light, pictures, e, i)
        panel.fill_panel(_panel(shown[i - first], alpha, e), light, alpha, e.cell, e.dark)


@part
def _nodes(camera, cell, e, i):
    """Return the Nodes of image i."""
    lens, shapes = _camera(e.lenses[i]), (e.coefficients[i], e.widths[i], e.added_variance[i])
    return nodes.nodes_of(camera, lens, cell, shapes[0], shapes[1], shapes[2], e.sites, e.budget)


@part
def _readout(camera, e, i):
    """Return the Readout of image i."""
    dark, photons = np.float32(camera.dark_noise), np.float32(camera.photon_noise)
    return Readout(e.noisy, dark, photons, keys(e.seeds[i]), e.clips)


@part
def _size_in_panel_pixels(alpha, e):
    """Return the height and width of a picture on the panel, rounded up."""
    return math.ceil(alpha * e.size[0]), math.ceil(alpha * e.size[1])


@kernel
def expose(raw, shown, e, first, last, top, bottom):
    """Fill rows `top` to `bottom` of raw (B, planes, h, w) float32 with the readings of the
    pictures from `first` to `last`, from what `show` filled shown with."""
    for i in range(first, last):
        camera = _camera(e.cameras[i])
        expose_image(
            raw[i],
            _panel(shown[i - first], camera.alpha, e),
            _size_in_panel_pixels(camera.alpha, e),
            FullImage(
                camera, e.cell, _nodes(camera, e.cell, e, i), e.sites,
                e.filters[i], e.white[i], e.flicker[i], _readout(camera, e, i),
            ),
            top,
            bottom,
        )  # fmt: skip


@part
def _content(camera, sensor, cell, e, i):
    """Return the Nodes and the BinStencil of image i of a binned reading: one of them is empty."""
    if not stencil.has_stencil(camera, sensor):
        return _nodes(camera, cell, e, i), stencil.no_stencil()
    none, lens = nodes.no_nodes(len(e.widths[i])), _camera(e.lenses[i])
    return none, stencil.stencil_of(
        camera, lens, cell, e.widths[i], e.added_variance[i], e.sites, e.budget
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
    """Return for each image whether `expose_binned` can follow its beats, (B,) bool."""
    out = np.empty(len(b.cameras), np.bool_)
    for i in range(len(out)):
        camera = _camera(b.cameras[i])
        out[i] = beat_terms.can_follow_beats(
            e.sites, camera, b.enlargement[i], b.triangle[i], b.period, b.orders, b.strength[i],
            e.budget,
        )  # fmt: skip
    return out


@kernel
def expose_binned(raw, shown, e, b, first, last, top, bottom):
    """Fill rows `top` to `bottom` of raw (B, planes, h, w) float32 with the binned readings of the
    pictures from `first` to `last`, from what `show` filled shown with; b: see
    `exposure_records.Beats`."""
    for i in range(first, last):
        camera, cell = _camera(e.cameras[i]), _cell_of(e.cell, b.centres[i])
        sensor = _camera(b.cameras[i])
        pattern = Pattern(
            b.coefficients[i], b.mean[i], b.lost_noise_variance[i], b.saturates, b.bayer
        )
        content = _content(camera, sensor, cell, e, i)
        terms = beats.terms_of(b, i, sensor, e.filters[i], e.size, e.sites, e.budget)
        expose_bins(
            raw[i],
            _panel(shown[i - first], camera.alpha, e),
            _size_in_panel_pixels(camera.alpha, e),
            BinnedImage(
                camera, sensor, cell, content[0], content[1], e.sites, terms, pattern,
                e.filters[i], e.white[i], e.flicker[i], _readout(camera, e, i),
            ),
            top,
            bottom,
        )  # fmt: skip


@kernel
def expose_points(raw, light, pictures, e, first, last):
    """Fill raw (B, planes, h, w) float32 with the readings of the pictures from `first` to `last`
    at points of the panel; arguments as in `show`."""
    for i in range(first, last):
        _light(light, pictures, e, i)
        camera = _camera(e.cameras[i])
        image = PointImage(
            camera, e.cell, e.point, e.point.lit[i], e.sites,
            e.filters[i], e.white[i], e.flicker[i], _readout(camera, e, i), e.dark,
        )  # fmt: skip
        expose_point(raw[i], light, image)


@part
def _way_back(registration, i):
    """Return the homography, k1 and k2 of image i."""
    k1, k2 = registration.lens[i]
    return registration.views[i], k1, k2


def photo_size(d) -> int:
    """Return how many values `develop` needs for a photo in the camera's frame."""
    return flat_length(*d.size) if d.registers else 0


@part
def _develop(out, raw, d, i, top, bottom):
    """Fill rows `top` to `bottom` of photo i from its raw."""
    h, w = d.size
    photo, in_camera = out.photos[i], out.photos[i]
    highest, lowest = top, bottom
    if d.registers:
        view, k1, k2 = _way_back(d.registration, i)
        in_camera = out.in_camera[: 3 * h * w].reshape(3, h, w)
        highest, lowest = rows_read(view, k1, k2, h, w, top, bottom)
    if d.finishes:
        unclipped = out.unclipped[i : i + 1]
        finish.finish(in_camera, unclipped, raw, d.codes, d.detail, i, highest, lowest)
    else:
        develop_image(in_camera, raw, d.codes, i, highest, lowest)
    if d.registers:
        register(photo, out.in_camera, view, k1, k2, top, bottom)


@kernel
def develop(out, raw, d, first, last, top, bottom):
    """Fill rows `top` to `bottom` of the photos from `first` to `last` from raw (B, planes, h, w)
    float32; out, d: see `development_records.Photos` and `Development`."""
    for i in range(first, last):
        _develop(out, raw[i], d, i, top, bottom)


@part
def _develop_back(raw_grad, grad, in_camera, unclipped, raw, d, i):
    """Fill raw_grad with the gradient in image i's raw, from that in its photo."""
    h, w = d.size
    if d.registers:
        view, k1, k2 = _way_back(d.registration, i)
        fill(in_camera, ZERO)
        register_back(in_camera, grad, view, k1, k2)
        grad = in_camera[: 3 * h * w].reshape(3, h, w)
    if d.finishes:
        h, w = d.detail.size
        codes_grad = np.empty((3, h, w), np.float32)
        finish.finish_back(codes_grad, grad, unclipped[i], d.detail, i)
        grad = codes_grad
    develop_image_back(raw_grad, grad, raw, d.codes, i)


@kernel
def develop_back(raw_grad, photo_grad, in_camera, unclipped, raw, d, first, last):
    """Fill the gradients from `first` to `last` in raw, of raw's shape, from those in the photos.

    Args:
        in_camera: (`photo_size`(d),) float32, workspace. unclipped: what `develop` filled.
        d: see `development_records.Development`.
    """
    for i in range(first, last):
        _develop_back(raw_grad[i], photo_grad[i], in_camera, unclipped, raw[i], d, i)
