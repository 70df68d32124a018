"""The records that the kernels of developing take, of plain numbers and arrays. For those of the
CPU, `cpu.develop_arrays` replaces `demosaic` and `cols`."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np


class Resize(NamedTuple):
    """A linear resize along one axis, from n sensor pixels to m photo pixels.

    Args:
        start: (m,) int64, the first sensor pixel of each photo pixel.
        taps: (m, T) float32, the weights from there on.
        first, last: (n,) int64, the photo pixels that each sensor pixel contributes to; none where
            last < first.
        size: n.
        halves: each photo pixel is the mean of two sensor pixels.
    """

    start: np.ndarray
    taps: np.ndarray
    first: np.ndarray
    last: np.ndarray
    size: int
    halves: bool


class Registration(NamedTuple):
    """What brings a batch's photos back to the image's frame; of length 0 if nothing does.

    Args:
        forward: (B, 3, 3) float64, homographies from image to ideal photo coordinates, both about
            their centres. distortion: (B, 2) float64, k1 and k2.
    """

    forward: np.ndarray
    distortion: np.ndarray


class Detail(NamedTuple):
    """What makes photos of a batch's codes of sensor pixels: filters, neutral if none is planned,
    and a resize.

    Args:
        size: height and width of the codes. rows, cols: the resize along both axes.
        chroma, sharp: (B,) float64, standard deviations in pixels of the Gaussians of colour and of
            the unsharp mask. chroma_size, sharp_size: pixels along their kernels.
        amount: (B,) float32, strength of the mask.
    """

    size: tuple[int, int]
    rows: Resize
    cols: Any
    chroma: np.ndarray
    chroma_size: int
    sharp: np.ndarray
    sharp_size: int
    amount: np.ndarray


class Codes(NamedTuple):
    """What makes codes of a batch's readings, and resizes them.

    Args:
        planes: of the readings. mosaic: they are of packed sites; else of colours, or of four
            planes, two of which are green. demosaic: (4 sites, 3 colours, 4 planes, 3 rows, 3
            columns) float32, how much a plane's pixel of a cell, of those around a site's own, is
            worth in a colour of the site; 0 if not `mosaic`.
        rows, cols: the resize along both axes.
        saturates: readings above 1 become 1. levels: the converter's 2^bits - 1, or 0. coded: light
            becomes sRGB codes.
        matrix: (B, 3, 3) float32, from the filters' colours to the photo's. mixes: whether it is
            more than a gain for each colour.
        toned: codes go through a tone curve of shoulder and contrast, (B,) float32 each. brighten:
            (B,) float32.
    """

    planes: int
    mosaic: bool
    demosaic: Any
    rows: Resize
    cols: Any
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
    """A batch's development, as kernels take it.

    Args:
        size: height and width of the photos.
        filters_detail: `codes` keeps every sensor pixel, and `detail` makes photos of them.
        registers: the photos come back to the image's frame.
    """

    size: tuple[int, int]
    codes: Codes
    filters_detail: bool
    detail: Detail
    registers: bool
    registration: Registration
