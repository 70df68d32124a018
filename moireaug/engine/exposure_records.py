"""The records that the kernels of exposing take, of plain numbers and arrays: one `Camera` per
image, one `Cell` (of binned readings, one per image) and one `Sites` per batch."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from moireaug.engine.budget import ErrorBudget


class Camera(NamedTuple):
    """One image's camera, as numbers.

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
    dark_noise: float  # standard deviation of the noise in the dark
    photon_noise: float  # standard deviation of photon noise at full scale
    falloff: float  # squared tangent of the corner's ray; 0 is no vignetting
    motion_x: float  # standard deviation of motion blur, sensor pixels
    motion_y: float
    glare: float  # light that the glass reflects, as a share of a white screen's
    glare_u: float  # what a photo pixel to the right, and one down, adds to it
    glare_v: float
    rectified: float  # 1 if pixels lie in the image's frame; then h is about both centres


class Cell(NamedTuple):
    """The panel's subpixels: n of several kinds. A kind is a shape and a period; its cell is what
    repeats with that period.

    Args:
        whole: (2,) int64, a common period of all kinds, panel pixels along x and y.
        period: (kinds, 2) int64, panel pixels along x and y.
        orders: (kinds, 2) int64, the highest harmonic along x and y, in cycles per cell.
        channel, kind: (n,) int64. y_group: (n,) int64, equal for subpixels whose centres have the
            same y and period along it. kind_y_group: (n,) int64, equal for those of one kind, too.
        centre: (n, 2) float64, panel pixels. pixel: (n, 2) int64, the panel pixel whose value it
            shows.
        radius: r in cells; content is taken from 2 r + 1 of them along each axis.
    """

    whole: np.ndarray
    period: np.ndarray
    orders: np.ndarray
    channel: np.ndarray
    kind: np.ndarray
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


class Point(NamedTuple):
    """The panel of a point exposure.

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
        cameras: (B, fields) float64, the fields of one `Camera` per image, of the pixels that are
            read. lenses: likewise, of their blur: the same, or in a binned reading, those of sensor
            pixels.
        filters: (B, 3, 3) float64, what each filter passes of red, green and blue light.
        white: (B, planes) float64, what each plane reads of a white screen on average.
        black: (B,) float32, light of a black pixel as a share of a white one's.
        coefficients: (B, kinds, K + 1, 2 L + 1) float64, of harmonics k = 0 ... K and l = -L ... L
            of each kind's mask, in cycles per cell.
        widths: (B, kinds, 2) float64, of each kind along x and y, in cells.
        added_variance: (B, kinds, 2) float64, squared cells: of a kind's slant; in bins, `hold` of
            `bin_content.Content`.
        flicker: (B, rows) float64, each sensor row's light relative to the mean; or (B, 0).
        seeds: (B,) int64, of the noise. noisy: whether there is any.
        coded: the pictures hold sRGB codes and the panel turns them into light.
        neighbour_share: (B,) float32, share of a picture pixel's light that comes from its
            neighbours; see `picture.fill_light`.
        dark: the panel is black beyond the picture, else it repeats the outermost pixel.
        clips: the reading is clipped to [0, 1].
        budget: what is left out.
        point: of a point exposure, which does not use coefficients, widths and added_variance;
            else None.
    """

    size: tuple[int, int]
    cameras: np.ndarray
    lenses: np.ndarray
    filters: np.ndarray
    white: np.ndarray
    black: np.ndarray
    cell: Cell
    coefficients: np.ndarray
    widths: np.ndarray
    added_variance: np.ndarray
    sites: Sites
    flicker: np.ndarray
    seeds: np.ndarray
    noisy: bool
    coded: bool
    neighbour_share: np.ndarray
    dark: bool
    clips: bool
    budget: ErrorBudget
    point: Point | None = None


class Nodes(NamedTuple):
    """What varies slowly over one image's photo, from `nodes.nodes_of`.

    Args:
        terms: (T, 4) int64, see `harmonics`.
        lines: (columns of a filter cell, rows of nodes, T * w) float32, each term's amplitude at
            each pixel of a row.
        step_v: from one row of nodes to the next.
        tables, phases, taps: from `weights.tap_weight_tables`, on `columns` nodes a row.
        step_uw, step_vw: from one of the tables' nodes to the next.
    """

    terms: np.ndarray
    lines: np.ndarray
    step_v: float
    tables: np.ndarray
    phases: np.ndarray
    taps: np.ndarray
    columns: int
    step_uw: float
    step_vw: float


class TapWeights(NamedTuple):
    """Where in a table the tap weights of n pixels lie, along one axis and for one kind of
    subpixel.

    Args:
        table: flat float32, from `weights.tap_weight_tables`. to_next: int32, from a node's weights
            to the next node's.
        weight_index: (n,) int32, index in the table of the weights of the phase before each pixel.
        phase_share: (n,) float32, how far the pixel is towards the next phase. node_share: (n,)
            float32, how far it is towards the next node.
    """

    table: np.ndarray
    to_next: np.int32
    weight_index: np.ndarray
    phase_share: np.ndarray
    node_share: np.ndarray


class Readout(NamedTuple):
    """How the sensor turns one image's light into readings; plain numbers.

    Args:
        noisy: whether readings have noise. dark_noise: float32, its standard deviation in the dark.
            photon_noise: float32, that of photon noise at full scale.
        keys: of the noise, two uint32 from `random_numbers.keys`.
        clips: readings are clipped to [0, 1].
    """

    noisy: bool
    dark_noise: np.float32
    photon_noise: np.float32
    keys: tuple[np.uint32, np.uint32]
    clips: bool


class FullImage(NamedTuple):
    """What one image's full reading is computed from.

    filters, white, flicker: the image's rows of its Exposure; see there.
    """

    camera: Camera
    cell: Cell
    nodes: Nodes
    sites: Sites
    filters: np.ndarray
    white: np.ndarray
    flicker: np.ndarray
    readout: Readout


class PointImage(NamedTuple):
    """What one image's point exposure is computed from.

    Args:
        lit: share of each subpixel that emits.
        filters, white, flicker: the image's rows of its Exposure; dark: as there.
    """

    camera: Camera
    cell: Cell
    point: Point
    lit: float
    sites: Sites
    filters: np.ndarray
    white: np.ndarray
    flicker: np.ndarray
    readout: Readout
    dark: bool
