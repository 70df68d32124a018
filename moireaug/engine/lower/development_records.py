"""The records that the kernels of developing take, of plain numbers and arrays."""

from __future__ import annotations

from typing import Generic, NamedTuple, TypeVar

import numpy as np

# an array and a Resize as lowered; CPU kernels take what `cpu.develop_arrays` makes of them
DemosaicT = TypeVar("DemosaicT")
ColumnsT = TypeVar("ColumnsT")


class Resize(NamedTuple):
    """A linear resize along one axis, from n sensor pixels to m photo pixels.

    Args:
        start: (m,) int64, the first sensor pixel of each photo pixel.
        taps: (m, T) float32, the weights from there on.
        first, last: (n,) int64, the photo pixels that each sensor pixel contributes to; none where
            last < first.
        is_identity: each photo pixel is a sensor pixel. halves: each is the mean of two.
    """

    start: np.ndarray
    taps: np.ndarray
    first: np.ndarray
    last: np.ndarray
    is_identity: bool
    halves: bool


class Registration(NamedTuple):
    """What brings a batch's photos back to the image's frame; of length 0 if nothing does.

    Args:
        forward: (B, 3, 3) float64, see `register.register`.
        lens: (B, 2) float64, k1 and k2.
    """

    forward: np.ndarray
    lens: np.ndarray


class Detail(NamedTuple, Generic[ColumnsT]):
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
    cols: ColumnsT
    chroma: np.ndarray
    chroma_size: int
    sharp: np.ndarray
    sharp_size: int
    amount: np.ndarray


class Codes(NamedTuple, Generic[DemosaicT, ColumnsT]):
    """What makes codes of a batch's readings, and resizes them.

    Args:
        mosaic: the readings are packed planes. demosaic: (4 sites, 3 colours, 4 planes, 3 rows, 3
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

    mosaic: bool
    demosaic: DemosaicT
    rows: Resize
    cols: ColumnsT
    saturates: bool
    levels: np.float32
    matrix: np.ndarray
    mixes: bool
    coded: bool
    toned: bool
    shoulder: np.ndarray
    contrast: np.ndarray
    brighten: np.ndarray


class Development(NamedTuple, Generic[DemosaicT, ColumnsT]):
    """A batch's development, as kernels take it.

    Args:
        size: height and width of the photos.
        finishes: `codes` keeps every sensor pixel, and `detail` makes photos of them.
        registers: the photos come back to the image's frame.
    """

    size: tuple[int, int]
    codes: Codes[DemosaicT, ColumnsT]
    finishes: bool
    detail: Detail[ColumnsT]
    registers: bool
    registration: Registration
