"""The kernels' inputs: plain numbers and arrays, one `Camera` per image and one `Cell` and one
`Sites` per batch."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

LANES = 16  # pixels that kernels work on at once; rows are padded to a multiple


class Camera(NamedTuple):
    """One image's drawn numbers, floats.

    h00 ... h22 is the homography from ideal photo coordinates about the photo's centre to image
    coordinates; `bend` is 4 / (H^2 + W^2), which scales squared radii for the lens's k1 and k2.
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
    bend: float
    alpha: float
    scale_u: float  # sensor pixels per photo pixel, along u and v
    scale_v: float
    fill: float
    blur: float
    olpf: float
    gain: float
    read: float  # standard deviation of the noise in the dark
    shot: float  # and of photon noise at full scale
    falloff: float  # squared tangent of the corner's ray; 0 is no vignetting
    motion_x: float  # standard deviation of the motion's spread, sensor pixels
    motion_y: float
    glare: float  # light that the glass reflects, as a share of a white screen's
    glare_u: float  # and what a photo pixel to the right, and down, adds to it
    glare_v: float


class Cell(NamedTuple):
    """The panel's subpixels: n of several kinds; a kind is a shape and a period. The cell of a kind
    is what its copies repeat with.

    Args:
        whole: (2,) int64, a period of them all: panel pixels along x and y.
        period: (kinds, 2) int64, panel pixels along x and y.
        orders: (kinds, 2) int64, the highest harmonic along x and y, in cycles per cell.
        channel, kind: (n,) int64. height, row: (n,) int64, the same for those of one height and one
            period along y, and for those that are of one kind, too.
        centre: (n, 2) float64, panel pixels. pixel: (n, 2) int64, the panel pixel whose value it
            shows.
        taps: r; content is taken from 2 r + 1 cells along each axis.
    """

    whole: np.ndarray
    period: np.ndarray
    orders: np.ndarray
    channel: np.ndarray
    kind: np.ndarray
    height: np.ndarray
    row: np.ndarray
    centre: np.ndarray
    pixel: np.ndarray
    taps: int


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


class Point(NamedTuple):
    """What a point exposure knows of the panel.

    Args:
        rectangles: (n, 4) float64, the subpixels' x0, y0, x1, y1 in panel pixels from the cell's
            corner.
        raster: raster subpixels along each side of a panel pixel.
        lit: (B,) float64, share of each subpixel that emits.
    """

    rectangles: np.ndarray
    raster: int
    lit: np.ndarray


class Exposure(NamedTuple):
    """A batch's exposure, as `run.expose` takes it.

    Args:
        size: height and width of the pictures.
        cameras: (B, fields) float64, those of one `Camera` per image.
        filters: (B, 3, 3) float64, what each filter passes of red, green and blue light.
        white: (B, planes) float64, what each plane reads of a white screen on average.
        black: (B,) float32, light of a black pixel as a share of a white one's.
        coefficients: (B, kinds, K + 1, 2 L + 1) float64, of harmonics k = 0 ... K and l = -L ... L
            of each kind's mask, in cycles per cell.
        widths: (B, kinds, 2) float64, of each kind along x and y, in cells. skew: the variance that
            its slant adds.
        flicker: (B, rows) float64, each sensor row's light relative to the mean; or (B, 0).
        seeds: (B,) int64, of the noise. noise: whether there is any.
        coded: the pictures hold sRGB codes and the panel turns them into light.
        share: (B,) float32, share of a picture pixel's light that comes from its neighbours; see
            `picture.show`.
        dark: the panel is black beyond the picture, else it repeats the outermost pixel.
        clips: the reading is clipped to [0, 1].
        point: for a point exposure, which reads no coefficients, widths and skew; else None.
    """

    size: tuple[int, int]
    cameras: np.ndarray
    filters: np.ndarray
    white: np.ndarray
    black: np.ndarray
    cell: Cell
    coefficients: np.ndarray
    widths: np.ndarray
    skew: np.ndarray
    sites: Sites
    flicker: np.ndarray
    seeds: np.ndarray
    noise: bool
    coded: bool
    share: np.ndarray
    dark: bool
    clips: bool
    point: Point | None = None


class Nodes(NamedTuple):
    """What `nodes.prepare` finds for one image.

    Args:
        terms: (T, 4) int64, see `harmonics`.
        lines: (columns of a filter cell, rows of nodes, T * w) float32, each term's amplitude at
            each pixel of a row.
        step_v: from one row of nodes to the next.
        tables, phases, cells: from `weights.weights`, on `columns` nodes a row.
        step_uw, step_vw: from one of the tables' nodes to the next.
    """

    terms: np.ndarray
    lines: np.ndarray
    step_v: float
    tables: np.ndarray
    phases: np.ndarray
    cells: np.ndarray
    columns: int
    step_uw: float
    step_vw: float


class Stencil(NamedTuple):
    """A linear demosaic: each site's colours as sums over the packed planes of the cell rows above,
    at and below it.

    Args:
        weight: (taps,) float32. offset: (taps,) int64, where in a prepared cell row the tap's pixel
            is.
        first, count: (4 sites, 3 channels, 3 rows) int64, which taps belong to each.
    """

    weight: np.ndarray
    offset: np.ndarray
    first: np.ndarray
    count: np.ndarray  # type: ignore[assignment]  # hides tuple.count: not called


class Resize(NamedTuple):
    """A linear resize along one axis, from n sensor pixels to m photo pixels.

    Args:
        start: (m,) int64, the first sensor pixel of each photo pixel.
        taps: (m, T) float32, the weights from there on.
        first, last: (n,) int64, the photo pixels that each sensor pixel contributes to; none where
            last < first.
        index, weight: (T, m) int32 and float32, the same in the order in which `develop` holds a
            row's colours.
        back_index, back_weight: (p, T', n / p), the transpose; p is 2 if even and odd columns are
            held apart, else 1.
        each: each photo pixel is a sensor pixel. pairs: each is the mean of two of its own.
    """

    start: np.ndarray
    taps: np.ndarray
    first: np.ndarray
    last: np.ndarray
    index: np.ndarray  # type: ignore[assignment]  # hides tuple.index: not called
    weight: np.ndarray
    back_index: np.ndarray
    back_weight: np.ndarray
    each: bool
    pairs: bool


class Registration(NamedTuple):
    """A batch's way back to the image's frame; of length 0 if nothing is registered.

    Args:
        views: (B, 3, 3) float64, see `register.register`.
        lens: (B, 2) float64, k1 and k2.
    """

    views: np.ndarray
    lens: np.ndarray


class Detail(NamedTuple):
    """A batch's way from the codes of every sensor pixel to photos; neutral if no filter is
    planned.

    Args:
        size: height and width of the codes. rows, cols: the resize along both axes.
        chroma, sharp: (B,) float64, standard deviations in pixels of the Gaussians of colour and of
            the unsharp mask. chroma_size, sharp_size: pixels along their kernels.
        amount: (B,) float32, strength of the mask.
    """

    size: tuple[int, int]
    rows: Resize
    cols: Resize
    chroma: np.ndarray
    chroma_size: int
    sharp: np.ndarray
    sharp_size: int
    amount: np.ndarray


class Codes(NamedTuple):
    """A batch's way from readings to codes, and their resize.

    Args:
        mosaic: the readings are packed planes. rows, cols: the resize along both axes.
        saturates: readings above 1 become 1. levels: the converter's 2^bits - 1, or 0. coded: light
            becomes sRGB codes.
        matrix: (B, 3, 3) float32, from the filters' colours to the photo's. mixes: whether it is
            more than a gain for each colour.
        toned: codes go through a tone curve of shoulder and contrast, (B,) float32 each. brighten:
            (B,) float32.
    """

    mosaic: bool
    stencil: Stencil
    rows: Resize
    cols: Resize
    saturates: bool
    levels: np.float32
    matrix: np.ndarray
    mixes: bool
    coded: bool
    toned: bool
    shoulder: np.ndarray
    contrast: np.ndarray
    brighten: np.ndarray


class Development(NamedTuple):
    """A batch's development, as `run.develop` takes it.

    Args:
        size: height and width of the photos.
        finishes: `codes` leaves every sensor pixel, and `detail` makes photos of them.
        registers: the photos come back to the image's frame.
    """

    size: tuple[int, int]
    codes: Codes
    finishes: bool
    detail: Detail
    registers: bool
    registration: Registration
