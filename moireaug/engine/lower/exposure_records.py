"""The records that the kernels of exposing take, of plain numbers and arrays: an Exposure, and one
of three views, which say how its pixels see the panel.

| view | `Exposure.cameras` | `blur_cameras`: what blurs them | `Beats.cameras` |
|---|---|---|---|
| FullView | sensor pixels | the same | |
| BinnedView | photo pixels | sensor pixels on the picture | sensor pixels on the panel |
| PointView | sensor pixels | | |
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from moireaug.engine.lower.budget import ErrorBudget


class Camera(NamedTuple):
    """One image's camera, as numbers.

    h00 ... h22 is the homography from ideal photo coordinates about the photo's centre to image
    coordinates; `radius_scale` is 4 / (H^2 + W^2), which scales squared radii for the lens's k1 and
    k2. `alpha` is panel pixels per image pixel, of the panel that is looked at.
    """

    h00: float
    h01: float
    h02: float
    h10: float
    h11: float
    h12: float
    h20: float
    h21: float
    h22: float
    k1: float
    k2: float
    radius_scale: float
    alpha: float
    scale_u: float  # sensor pixels per photo pixel, along u and v
    scale_v: float
    fill: float
    blur: float
    olpf: float
    gain: float
    dark_noise: float  # standard deviation of the noise in the dark
    photon_noise: float  # standard deviation of photon noise at full scale
    falloff: float  # squared tangent of the corner's ray; 0 is no vignetting
    motion_x: float  # standard deviation of motion blur, sensor pixels
    motion_y: float
    glare: float  # light that the glass reflects, as a share of a white screen's
    glare_u: float  # what a photo pixel to the right, and one down, adds to it
    glare_v: float
    rectified: float  # 1 if pixels lie in the image's frame; then h is about both centres
    photo_height: float  # of the whole photo, in photo pixels
    photo_width: float
    centre_u: float  # where the middle of what is read lies, about the whole photo's centre; of a
    centre_v: float  # rectified camera, about that of the picture's frame
    lead_x: float  # pixels of the panel that is looked at, before the picture begins; less than 1
    lead_y: float
    corner_x: float  # from that panel's corner to the centre of the picture's frame, image pixels
    corner_y: float
    pulses_top: float  # row of the first band of an `Exposure.flicker`, about the photo's centre
    pulses_height: float  # rows from it to the last one


class Cell(NamedTuple):
    """The panel's subpixels: n of several kinds. A kind is a shape and a period; its cell is what
    repeats with that period.

    Args:
        common_period: (2,) int64, of all kinds, panel pixels along x and y.
        period: (kinds, 2) int64, panel pixels along x and y.
        orders: (kinds, 2) int64, the highest harmonic along x and y, in cycles per cell.
        channel, subpixel_kind: (n,) int64. y_group: (n,) int64, equal for subpixels whose centres
            have the same y and period along it. kind_y_group: (n,) int64, equal for those of one
            kind, too.
        centre: (n, 2) float64, panel pixels. pixel: (n, 2) int64, the panel pixel whose value it
            shows.
        radius: r in cells; content is taken from 2 r + 1 of them along each axis.
    """

    common_period: np.ndarray
    period: np.ndarray
    orders: np.ndarray
    channel: np.ndarray
    subpixel_kind: np.ndarray
    y_group: np.ndarray
    kind_y_group: np.ndarray
    centre: np.ndarray
    pixel: np.ndarray
    radius: int


class Sites(NamedTuple):
    """Where the pixels of the sensor's planes lie.

    Args:
        rows, cols: float64 photo coordinates, about the photo's centre, of the sensor's rows and
            columns.
        step: rows or columns from one pixel of a plane to the next.
        row, col, channel: (planes,) int64, of each plane's first pixel.
    """

    rows: np.ndarray
    cols: np.ndarray
    step: int
    row: np.ndarray
    col: np.ndarray
    channel: np.ndarray


class Exposure(NamedTuple):
    """A batch's exposure, however its pixels see the panel.

    Args:
        size: height and width of the pictures.
        cameras: (B, fields) float64, the fields of one `Camera` per image, of the pixels that are
            read.
        filters: (B, 3, 3) float64, what each filter passes of red, green and blue light.
        white: (B, planes) float64, what each plane reads of a white screen on average.
        black: (B,) float32, light of a black pixel as a share of a white one's.
        flicker: (B, rows) float64, each sensor row's light relative to the mean, or of a binned
            reading, that of bands from `Camera.pulses_top` on; or (B, 0).
        keys: (B, 2) int32, of the noise, see `random_numbers.keys`. noisy: whether there is any.
        coded: the pictures hold sRGB codes and the panel turns them into light.
        neighbour_share: (B,) float32, share of a picture pixel's light that comes from its
            neighbours; see `picture.fill_light`.
        dark_around: the panel is black beyond the picture, else it repeats the outermost pixel.
        clips: the reading is clipped to [0, 1].
        budget: what is left out, but of a point exposure nothing is.
    """

    size: tuple[int, int]
    cameras: np.ndarray
    filters: np.ndarray
    white: np.ndarray
    black: np.ndarray
    cell: Cell
    sites: Sites
    flicker: np.ndarray
    keys: np.ndarray
    noisy: bool
    coded: bool
    neighbour_share: np.ndarray
    dark_around: bool
    clips: bool
    budget: ErrorBudget


class FullView(NamedTuple):
    """How pixels that integrate see the kinds of subpixel of a batch's panels.

    Args:
        blur_cameras: (B, fields) float64, the fields of one `Camera` per image, of the pixels'
            blur.
        coefficients: (B, kinds, K + 1, 2 L + 1) float64, of harmonics k = 0 ... K and l = -L ... L
            of each kind's mask, in cycles per cell.
        widths: (B, kinds, 2) float64, of each kind along x and y, in cells.
        added_variance: (B, kinds, 2) float64, squared cells: of a kind's slant; in bins,
            `interpolation_variance` of `bin_content.BinContent`.
    """

    blur_cameras: np.ndarray
    coefficients: np.ndarray
    widths: np.ndarray
    added_variance: np.ndarray


class Beats(NamedTuple):
    """The pattern of a batch's panels that binned readings show.

    Args:
        cameras: (B, fields) float64, those of one `Camera` per image, of sensor pixels.
        enlargement: (B,) float64, factor by which bins are enlarged to the size of a sensor pixel.
            sampled: their sides are the sensor's pixels, whatever their size. triangle: (B,)
            float64, see `bin_geometry.Bins`. ratio: (B,) float64, panel pixels per
            pixel of the panel that is shown.
        centres: (B, 3, 2) float64, where each colour's pixel lies in its cell.
        start: (B, 2) float64, where the corner of the panel that is shown lies on the real one, in
            its pixels.
        period: (2,) int64, of the layout. orders: (K, 2) int64, its harmonics.
        coefficients: (B, 3, K, 2) float32, twice those of each channel's light, real and imaginary
            part. strength: (B, K) float64, the greatest of a harmonic. mean: (B, 3) float64, share
            of the panel's area that emits each channel.
        lost_noise_variance: (B, 2) float32, of the noise that bins average away: in the dark, and
            what a reading of 1 adds.
        saturates: whether the pattern can fill a sensor pixel's well. bayer: whether the sensor has
            colour filters.
    """

    cameras: np.ndarray
    enlargement: np.ndarray
    sampled: bool
    triangle: np.ndarray
    ratio: np.ndarray
    centres: np.ndarray
    start: np.ndarray
    period: np.ndarray
    orders: np.ndarray
    coefficients: np.ndarray
    strength: np.ndarray
    mean: np.ndarray
    lost_noise_variance: np.ndarray
    saturates: bool
    bayer: bool


class BinnedView(NamedTuple):
    """How bins see a batch's panels: the picture, as on a panel whose cell is one pixel of each
    colour that emits all over, times the pattern."""

    picture: FullView
    beats: Beats


class PointView(NamedTuple):
    """How the points of a point exposure see a batch's panels.

    Args:
        rectangles: (n, 4) float64, the subpixels' x0, y0, x1, y1 in panel pixels from the cell's
            corner.
        raster: raster subpixels along each side of a panel pixel.
        lit: (B,) float64, share of each subpixel that emits.
    """

    rectangles: np.ndarray
    raster: int
    lit: np.ndarray


PanelView = FullView | BinnedView | PointView
