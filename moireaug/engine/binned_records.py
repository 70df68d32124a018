"""The records that only the kernels of binned readings take: the panel's beats, and the stencils of
bins that are the image's own pixels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from moireaug.engine.exposure_records import Camera, Cell, Nodes, Readout, Sites


class Beats(NamedTuple):
    """What a batch's binned readings take of the panel besides its Exposure, whose cameras are of
    photo pixels and whose cell holds one pixel of each colour.

    Args:
        cameras: (B, fields) float64, those of one `Camera` per image, of sensor pixels.
        enlargement: (B,) float64, factor by which bins are enlarged to the size of a sensor pixel.
            triangle: (B,) float64, see `exposure.bins.Bins`. ratio: (B,) float64, panel pixels per
            pixel of the panel that is shown.
        centres: (B, 3, 2) float64, where each colour's pixel lies in its cell.
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
    triangle: np.ndarray
    ratio: np.ndarray
    centres: np.ndarray
    period: np.ndarray
    orders: np.ndarray
    coefficients: np.ndarray
    strength: np.ndarray
    mean: np.ndarray
    lost_noise_variance: np.ndarray
    saturates: bool
    bayer: bool


class Terms(NamedTuple):
    """The waves of one image's beats, T of them, from `beats.terms_of`.

    Args:
        harmonic: (T,) int64. wave: (T, 5) float64 and sign: (T, 2) float32, see
            `beats._fill_waves`.
        lines: (rows of nodes, T * 2 * w) float32, each term's amplitude at each pixel of a row, as
            the planes of red and blue, and of green, read it. peak: (rows, T) float32, the greatest
            of a row; those below least_amplitude are left out there. step_v: from one row of nodes
            to the next.
        lost_pattern_variance: (3,) float32, of the panel's pattern that bins average away, as a
            share of the squared mean light, by colour filter.
    """

    harmonic: np.ndarray
    wave: np.ndarray
    sign: np.ndarray
    lines: np.ndarray
    peak: np.ndarray
    least_amplitude: float
    step_v: float
    lost_pattern_variance: np.ndarray


class Pattern(NamedTuple):
    """One image's rows of its Beats; see there."""

    coefficients: np.ndarray
    mean: np.ndarray
    lost_noise_variance: np.ndarray
    saturates: bool
    bayer: bool


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


class BinnedImage(NamedTuple):
    """What one image's binned reading is computed from.

    Args:
        camera: of photo pixels. sensor: of sensor pixels.
        nodes, stencil: one of them is empty.
        filters, white, flicker: the image's rows of its Exposure; see there.
    """

    camera: Camera
    sensor: Camera
    cell: Cell
    nodes: Nodes
    stencil: BinStencil
    sites: Sites
    terms: Terms
    pattern: Pattern
    filters: np.ndarray
    white: np.ndarray
    flicker: np.ndarray
    readout: Readout
