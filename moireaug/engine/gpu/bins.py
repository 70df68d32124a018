"""The bins of a binned reading: where each lies and looks, and which pixels of a `panel.Screen` it
sees."""

from __future__ import annotations

from typing import Any, NamedTuple

import triton
import triton.language as tl

from moireaug.engine.gpu.arrays import CAMERA_FIELDS
from moireaug.engine.gpu.beat_terms import BeatTerms
from moireaug.engine.gpu.footprint import MIN_BLUR_VARIANCE, Footprint, lit_shares
from moireaug.engine.gpu.optics import blur_variance
from moireaug.engine.gpu.panel import pixel_scale
from moireaug.engine.gpu.physics import bins as geometry
from moireaug.engine.gpu.physics import footprint as view
from moireaug.engine.gpu.view import (
    ALPHA,
    CORNER_X,
    CORNER_Y,
    PHOTO_HEIGHT,
    PHOTO_WIDTH,
    SCALE_U,
    SCALE_V,
    jacobian,
    lens_of,
    load32,
    to_image,
    to_photo,
)
from moireaug.engine.lower.exposure_records import Beats, Exposure, FullView


class Patch(NamedTuple):
    """Pixels shown: their first column and row, int32, which may be beyond the edge, and the
    weights of as many columns and rows as there are weights."""

    left: Any
    top: Any
    across: Any
    down: Any


@triton.jit
def channel_of(light, image, colour, screen):
    """Return a pointer to one channel of an image on the screen, or of the gradient in it."""
    return light + (image * 3 + colour) * screen.pixels[0] * screen.pixels[1]


@triton.jit
def within(first, offset, count):
    """Return pixels at an offset from the first, of `count`, or the outermost beyond the edges."""
    return tl.minimum(tl.maximum(first + offset, 0), count - 1)


@triton.jit
def content(channel, patch, screen):
    """Return the light of a Patch: the weighted sum of its pixels."""
    columns, rows = screen.pixels
    total = 0.0 * patch.across[0]
    for m in tl.static_range(len(patch.down)):
        line = channel + within(patch.top, m, rows) * columns
        of_row = 0.0 * total
        for n in tl.static_range(len(patch.across)):
            of_row += patch.across[n] * tl.load(line + within(patch.left, n, columns))
        total += patch.down[m] * of_row
    return total


@triton.jit
def add_content_back(channel, grad, patch, inside, screen):
    """Add the gradient in pixels shown to a channel, from that in their `content`."""
    columns, rows = screen.pixels
    for m in tl.static_range(len(patch.down)):
        line = channel + within(patch.top, m, rows) * columns
        for n in tl.static_range(len(patch.across)):
            back = grad * patch.down[m] * patch.across[n]
            at = line + within(patch.left, n, columns)
            tl.atomic_add(at, back, mask=inside & (back != 0.0))


class BinnedBatch(NamedTuple):
    """What the kernels read.

    Args:
        forward: (B, 9) float64, the inverse of the sensor's homographies. lost_pattern_variance:
            (B, 3) float32, see `beats.lost_pattern_variance_kernel`. quantiles: see
            `random_numbers.quantiles`.
        harmonics, bands: how many orders, and bands of flicker, there are.
    """

    exposure: Exposure
    picture: FullView
    beats: Beats
    terms: BeatTerms
    forward: Any
    lost_pattern_variance: Any
    harmonics: int
    bands: int
    screen: Any = None
    quantiles: Any = None


class BinnedVariant(NamedTuple):
    """What a kernel is compiled for, the same of all images of a batch.

    Args:
        period_x, period_y: of the layout, in panel pixels. taps: pixels of the panel that a bin
            sees along each axis.
        rectified: bins lie in the image's frame. sampled: see `exposure_records.Beats`.
        distorts: the lens distorts. bayer: the sensor has colour filters. dark_around: the panel is
            black beyond the picture.
        flickers, noisy, clips: see `exposure_records.Exposure`.
    """

    period_x: int
    period_y: int
    taps: int
    rectified: bool
    sampled: bool
    distorts: bool
    bayer: bool
    dark_around: bool
    flickers: bool
    noisy: bool
    clips: bool


class Bin(NamedTuple):
    """Bins of an image that a program reads.

    Args:
        image: its index, int64. x, y: float64, where their middles look, in panel pixels from
            `Beats.start` on. u, v: float64, where they lie, in photo pixels about the whole photo's
            centre.
        step_x, step_y: float32, panel pixels per sensor pixel along u and v.
        first, second: float32, their two sides along u and v, in sensor pixels. window: those in
            which the picture is seen; see `bin_geometry.Bins`.
    """

    image: Any
    x: Any
    y: Any
    u: Any
    v: Any
    step_x: Any
    step_y: Any
    first: Any
    second: Any
    window: Any


@triton.jit
def along(step, vector):
    """Return the product of two vectors along u and v."""
    return step[0] * vector[0] + step[1] * vector[1]


@triton.jit
def bins_at(u, v, image, batch, variant: tl.constexpr):
    """Return the Bin at photo points about the whole photo's centre; in the image's frame, at image
    points about the centre of the picture's frame."""
    sensor = batch.beats.cameras + image * CAMERA_FIELDS
    if variant.rectified:
        half_h = 0.5 * tl.load(sensor + PHOTO_HEIGHT)
        half_w = 0.5 * tl.load(sensor + PHOTO_WIDTH)
        x, y = u + tl.load(sensor + CORNER_X), v + tl.load(sensor + CORNER_Y)
        u, v = to_photo(u, v, batch.forward + image * 9, lens_of(sensor), variant.distorts)
        u = tl.minimum(tl.maximum(u, -half_w), half_w)  # others are put at the photo's edge
        v = tl.minimum(tl.maximum(v, -half_h), half_h)
    else:
        x, y = to_image(u, v, sensor)
    xu, xv, yu, yv = jacobian(u, v, sensor)
    scale, enlargement = tl.load(sensor + ALPHA), tl.load(batch.beats.enlargement + image)
    none = 0.0 * xu
    if variant.rectified:
        pixel = scale.to(tl.float32) * enlargement
        first, second = geometry.image_pixel_sides(xu, xv, yu, yv, pixel)
    else:
        first = none + load32(sensor, SCALE_U) * enlargement, none
        second = none, none + load32(sensor, SCALE_V) * enlargement
    window = first, second
    if variant.sampled:
        first, second = (none + 1.0, none), (none, none + 1.0)
    return Bin(image, x * scale, y * scale, u, v, (xu, xv), (yu, yv), first, second, window)


@triton.jit
def _along_axis(channel, position, step, bins, batch, AXIS: tl.constexpr, variant: tl.constexpr):
    """Return the first pixel shown that bins see along one axis, in one channel, and the weights of
    `variant.taps`.

    Args:
        position: panel coordinates, float64. step: their change per sensor pixel along u and v.
    """
    picture, index = batch.picture, (bins.image * 3 + channel) * 2 + AXIS
    ratio = tl.load(batch.beats.ratio + bins.image)
    by_u, by_v = step[0] * (1.0 / ratio), step[1] * (1.0 / ratio)
    blur_camera = picture.blur_cameras + bins.image * CAMERA_FIELDS
    one = tl.abs(along((by_u, by_v), bins.window[0]))
    other = tl.abs(along((by_u, by_v), bins.window[1]))
    short, hold = tl.minimum(one, other), tl.load(picture.added_variance + index)
    blur = blur_variance(by_u, by_v, blur_camera)
    variance = view.side_variance(short) + blur + hold + MIN_BLUR_VARIANCE
    footprint = Footprint(tl.maximum(one, other), tl.sqrt(variance))
    place = position * (1.0 / ratio.to(tl.float64)) - tl.load(batch.beats.centres + index)
    end = batch.screen.size[AXIS] * pixel_scale(blur_camera)
    nearest, shares = lit_shares(
        place, footprint, tl.load(picture.widths + index), (place + 0.5, 0.5, end), variant.taps,
        variant.dark_around,
    )  # fmt: skip
    return nearest.to(tl.int32) + (batch.screen.lead - variant.taps // 2), shares


@triton.jit
def patch_of(channel, bins, batch, variant: tl.constexpr):
    """Return the Patch that bins see in one channel."""
    left, across = _along_axis(channel, bins.x, bins.step_x, bins, batch, 0, variant)
    top, down = _along_axis(channel, bins.y, bins.step_y, bins, batch, 1, variant)
    return Patch(left, top, across, down)
