"""The kernels that Python calls, each on some of a batch's images, or on some rows of one. The
other modules' loops are compiled into them."""

from __future__ import annotations

import math

import numpy as np

from moireaug.engine import finish, nodes, panel, picture
from moireaug.engine.compiling import fill, kernel, loop, part
from moireaug.engine.develop import develop as develop_image
from moireaug.engine.develop_back import develop_back as develop_image_back
from moireaug.engine.expose import expose as expose_image
from moireaug.engine.point import expose_point
from moireaug.engine.record import Camera
from moireaug.engine.register import looked_at, room
from moireaug.engine.register import register as resample

MOST_PANEL = 16  # panel pixels per sensor pixel, up to which building the panel pays off
SMALL_PANEL = 2**20  # panel pixels that are never too many
ZERO = np.float32(0)


@loop
def _camera(row):
    """Return the Camera of a row of `Exposure.cameras`."""
    return Camera(
        row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8], row[9], row[10],
        row[11], row[12], row[13], row[14], row[15], row[16], row[17], row[18], row[19], row[20],
        row[21], row[22], row[23], row[24], row[25], row[26],
    )  # fmt: skip


@kernel
def fits(e):
    """Return for each image whether `expose` can follow its view, (B,) bool; e: see
    `record.Exposure`.

    The reference takes views near the horizon, and panels of far more pixels than the sensor.
    """
    out = np.empty(len(e.cameras), np.bool_)
    most = max(MOST_PANEL * len(e.sites.rows) * len(e.sites.cols), SMALL_PANEL)
    for i in range(len(out)):
        camera = _camera(e.cameras[i])
        h, w = panel.shape(e.size, camera.alpha, e.cell)
        out[i] = h * w <= most and nodes.fits(
            camera, e.cell, e.widths[i], e.skew[i], e.sites, e.dark
        )
    return out


@part
def _light(light, floats, codes, i, e):
    """Return the light of picture i, (3, H, W) float32: the picture itself if it is light already,
    else `light`, filled from it."""
    if len(codes):
        picture.show(light, codes[i], e.coded, e.black[i], e.share[i])
        return light
    if e.coded or e.black[i] != 0 or e.share[i] != 0:
        picture.show(light, floats[i], e.coded, e.black[i], e.share[i])
        return light
    return floats[i]


@part
def _panel(shown, e, i):
    """Return the part of shown that picture i takes as the panel shows it, (3, h, w)."""
    h, w = panel.shape(e.size, _camera(e.cameras[i]).alpha, e.cell)
    return shown[: 3 * h * w].reshape(3, h, w)


@kernel
def panel_size(e):
    """Return how many values the largest picture takes as the panel shows it."""
    most = 0
    for i in range(len(e.cameras)):
        h, w = panel.shape(e.size, _camera(e.cameras[i]).alpha, e.cell)
        most = max(most, 3 * h * w)
    return most


@part
def _show(shown, light, floats, codes, e, i):
    light, alpha = _light(light, floats, codes, i, e), _camera(e.cameras[i]).alpha
    panel.show(_panel(shown, e, i), light, alpha, e.cell, e.dark)


@kernel
def show(shown, light, floats, codes, e, i):
    """Fill shown with picture i as the panel shows it; arguments as in `expose`."""
    _show(shown, light, floats, codes, e, i)


@kernel
def expose(raw, shown, light, floats, codes, e, first, last, top, bottom):
    """Fill rows `top` to `bottom` of raw (B, planes, h, w) float32 with the readings of the
    pictures from `first` to `last`.

    Args:
        shown: (`panel_size`(e),) float32, workspace, or what `show` filled it with.
        light: (3, H, W) float32, workspace; (3, 0, 0) if the only picture is in `shown` already.
        floats, codes: (B, 3, H, W), float32 and uint8; one of them has no images.
        e: see `record.Exposure`.
    """
    for i in range(first, last):
        if light.size:
            _show(shown, light, floats, codes, e, i)
        camera = _camera(e.cameras[i])
        expose_image(
            raw[i],
            _panel(shown, e, i),
            (math.ceil(camera.alpha * e.size[0]), math.ceil(camera.alpha * e.size[1])),
            camera,
            e.filters[i],
            e.white[i],
            e.cell,
            nodes.prepare(camera, e.cell, e.coefficients[i], e.widths[i], e.skew[i], e.sites),
            e.sites,
            e.flicker[i],
            e.noise,
            e.seeds[i],
            e.clips,
            top,
            bottom,
        )


@kernel
def expose_points(raw, light, floats, codes, e, first, last):
    """Fill raw (B, planes, h, w) float32 with the readings of the pictures from `first` to `last`
    at points of the panel; arguments as in `expose`."""
    for i in range(first, last):
        expose_point(
            raw[i],
            _light(light, floats, codes, i, e),
            _camera(e.cameras[i]),
            e.filters[i],
            e.white[i],
            e.cell,
            e.point,
            e.point.lit[i],
            e.sites,
            e.flicker[i],
            e.noise,
            e.seeds[i],
            e.clips,
            e.dark,
        )


@part
def _way_back(registration, i):
    k1, k2 = registration.lens[i]
    return registration.views[i], k1, k2


@kernel
def photo_size(d):
    """Return how many values a photo in the camera's frame takes in `develop`."""
    return room(d.size[0], d.size[1])


@part
def _photo(photo, inside, raw, d, i, top, bottom):
    """Fill rows `top` to `bottom` of photo (3, H, W), in the camera's frame, from image i's raw."""
    if d.finishes:
        finish.finish(photo, inside[i : i + 1], raw, d.codes, d.detail, i, top, bottom)
    else:
        develop_image(photo, raw, d.codes, i, top, bottom)


@kernel
def develop(photos, taken, inside, raw, d, first, last, top, bottom):
    """Fill rows `top` to `bottom` of photos (B, 3, H, W) float32, sRGB codes, from `first` to
    `last` from raw (B, planes, h, w) float32.

    Args:
        taken: (`photo_size`(d),) float32, workspace.
        inside: (B, 3, ...) uint8, see `finish.finish`; (0, 3, ...) if not needed.
        d: see `record.Development`.
    """
    if not d.registers:
        for i in range(first, last):
            _photo(photos[i], inside, raw[i], d, i, top, bottom)
        return
    h, w = d.size
    n = 3 * h * w
    fill(taken[n:], ZERO)
    for i in range(first, last):
        view, k1, k2 = _way_back(d.registration, i)
        highest, lowest = looked_at(view, k1, k2, h, w, top, bottom)
        _photo(taken[:n].reshape(3, h, w), inside, raw[i], d, i, highest, lowest)
        resample(photos[i], taken, view, k1, k2, False, top, bottom)


@part
def _photo_back(raw_grad, grad, codes_grad, inside, raw, d, i):
    """Fill raw_grad with the gradient in image i's raw, from that in its photo in the camera's
    frame; codes_grad: workspace for `finish.finish_back`."""
    if d.finishes:
        finish.finish_back(codes_grad, grad, inside[i], d.detail, i)
        develop_image_back(raw_grad, codes_grad, raw, d.codes, i)
    else:
        develop_image_back(raw_grad, grad, raw, d.codes, i)


@kernel
def develop_back(raw_grad, photo_grad, inside, raw, d, first, last):
    """Fill raw_grad, of raw's shape, with the gradient in raw; arguments as in `develop`."""
    h, w = d.detail.size if d.finishes else (0, 0)
    codes_grad = np.empty((3, h, w), np.float32)
    if not d.registers:
        for i in range(first, last):
            _photo_back(raw_grad[i], photo_grad[i], codes_grad, inside, raw[i], d, i)
        return
    h, w = d.size
    planes = np.empty(room(h, w), np.float32)
    taken = planes[: 3 * h * w].reshape(3, h, w)
    for i in range(first, last):
        fill(planes, ZERO)
        view, k1, k2 = _way_back(d.registration, i)
        resample(photo_grad[i], planes, view, k1, k2, True, 0, h)
        _photo_back(raw_grad[i], taken, codes_grad, inside, raw[i], d, i)
