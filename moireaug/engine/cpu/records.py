"""The records that kernels pass on, of what is computed for one image at a time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from moireaug.engine.lower.exposure_records import Camera, Cell, Sites


class PixelView(NamedTuple):
    """How one image's pixels see the kinds of subpixel of its panel.

    Args:
        camera, blur_camera: of the pixels, and of what blurs them; see `exposure_records`.
        widths, added_variance: (kinds, 2), the image's rows of its FullView.
    """

    camera: Camera
    blur_camera: Camera
    cell: Cell
    widths: np.ndarray
    added_variance: np.ndarray


class CoarseGrid(NamedTuple):
    """What varies slowly over one image's photo, from `coarse_grid.coarse_grid_of`.

    Args:
        terms: (T, 4) int64, see `harmonics`.
        lines: (columns of a filter cell, rows of nodes, T * w) float32, each term's amplitude at
            each pixel of a row.
        step_v: from one row of nodes to the next.
        tables, phases, taps: from `tap_weights.weight_tables`, on `columns` nodes a row.
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
        table: flat float32, from `tap_weights.weight_tables`. to_next: int32, from a node's weights
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
        keys: of the noise, two uint32.
        clips: readings are clipped to [0, 1].
    """

    noisy: bool
    dark_noise: np.float32
    photon_noise: np.float32
    keys: tuple[np.uint32, np.uint32]
    clips: bool


class Terms(NamedTuple):
    """The waves of one image's beats, T of them, from `beats.beat_terms_of`.

    Args:
        harmonic: (T,) int64. wave: (T, 5) float64 and sign: (T, 3) float32, see
            `beats._fill_waves`.
        lines: (rows of nodes, T * 2 * w) float32, each term's amplitude at each pixel of a row, as
            the planes of red and blue, and of green, read it; of very many terms at each node,
            (rows, T * 2 * cols). peak: (rows, T) float32, the greatest of a row; those below
            least_amplitude are left out there. step_v: from one row of nodes to the next. ends,
            weight: of the columns of nodes, see `harmonics.interpolate_line`.
        lost_pattern_variance: (3,) float32, of the panel's pattern that bins average away, as a
            share of the squared mean light, by colour filter; 0 if it cannot saturate.
    """

    harmonic: np.ndarray
    wave: np.ndarray
    sign: np.ndarray
    lines: np.ndarray
    peak: np.ndarray
    least_amplitude: float
    step_v: float
    ends: np.ndarray
    weight: np.ndarray
    lost_pattern_variance: np.ndarray


class Pattern(NamedTuple):
    """One image's rows of its Beats; see there."""

    coefficients: np.ndarray
    mean: np.ndarray
    lost_noise_variance: np.ndarray
    saturates: bool


class BinStencil(NamedTuple):
    """The weights of one image's bins, from `stencil.stencil_of`.

    Args:
        lines: (rows of nodes, 3 * 2 * taps * w) float32, of each colour the weights along x, and
            then along y, of one pixel after another, at each bin.
        taps: pixels along each axis; 0 if the image has no stencil.
        step_v: from one row of nodes to the next.
    """

    lines: np.ndarray
    taps: int
    step_v: float


class BinnedSetup(NamedTuple):
    """What varies slowly over one image's binned photo.

    Args:
        grid, stencil: of the picture; one of them is empty. terms: of the beats.
    """

    grid: CoarseGrid
    stencil: BinStencil
    terms: Terms


class ImageBins(NamedTuple):
    """What the bins of one image have besides.

    Args:
        sensor: camera of sensor pixels; the image's own is of photo pixels.
        stencil, terms: see `BinnedSetup`.
    """

    sensor: Camera
    stencil: BinStencil
    terms: Terms
    pattern: Pattern


class ImagePoints(NamedTuple):
    """What the points of one image have besides.

    Args:
        size: height and width of the picture. rectangles, raster: of its PointView; lit: the
            image's there. dark_around: see `exposure_records.Exposure`.
    """

    size: tuple[int, int]
    rectangles: np.ndarray
    raster: int
    lit: float
    dark_around: bool


class Image(NamedTuple):
    """What one image's reading is computed from.

    Args:
        panel_size: height and width of the picture in panel pixels, rounded up.
        grid: None of a point exposure.
        filters, white, flicker: the image's rows of its Exposure; see there.
        bins, points: of a binned reading, and of a point exposure; else None.
    """

    camera: Camera
    panel_size: tuple[int, int]
    cell: Cell
    grid: CoarseGrid | None
    sites: Sites
    filters: np.ndarray
    white: np.ndarray
    flicker: np.ndarray
    readout: Readout
    bins: ImageBins | None
    points: ImagePoints | None


class Span(NamedTuple):
    """Which part of a batch is computed: rows `top` to `bottom` of reading i."""

    i: int
    top: int
    bottom: int


class Photos(NamedTuple):
    """What the development of a batch fills.

    Args:
        photos: (B, 3, H, W) float32, sRGB codes.
        in_camera: (`develop_kernels.in_camera_length`,) float32, workspace: a photo in the camera's
            frame, with zeros after it: a look-up at a plane's last pixels reads beyond them with
            weight 0.
        unclipped: (B, 3, ...) uint8, see `develop_kernels.develop_detail_rows`; (0, 3, ...) if not
            needed.
    """

    photos: np.ndarray
    in_camera: np.ndarray
    unclipped: np.ndarray
