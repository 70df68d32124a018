"""The Bayer mosaic: which sensor pixels are read, and how they become colours.

Raw readings are kept packed, `(B, 4, h / 2, w / 2)`, in the order R, G, G, B of the RGGB cell. Demosaicing, and an area
or point resize by a whole factor, are linear and repeat with the cell; so they are folded into one convolution of the
packed planes, whose kernel is read off the two steps themselves.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

CELL = ((0, 0), (0, 1), (1, 0), (1, 1))  # (row, column) of the planes R, G, G, B
CHANNELS = (0, 1, 1, 2)


def pack(mosaic: Tensor) -> Tensor:
    """(B, h, w) with even h and w to packed planes (B, 4, h / 2, w / 2)."""
    return torch.stack([mosaic[:, r::2, c::2] for r, c in CELL], 1)


def unpack(raw: Tensor) -> Tensor:
    """Packed planes (B, 4, h / 2, w / 2) to the mosaic (B, h, w)."""
    return F.pixel_shuffle(raw, 2)[:, 0]


@dataclass(frozen=True)
class Readout:
    """Which sensor rows (or columns) of one axis are read, and how they map to photo pixels.

    Args:
        index: the sensor pixels that are read, each of the parity of its place.
        step: pixels read per photo pixel, 0 where no whole number of them belongs to a photo pixel.
        lead: pixels read ahead of the first photo pixel's own.
        size: photo pixels.
        scale: sensor pixels per photo pixel.
    """

    index: tuple[int, ...]
    step: int
    lead: int
    size: int
    scale: float

    def positions(self, device: torch.device | None = None) -> Tensor:
        """Photo coordinates of the pixels' centres, (len(index),) float64."""
        return (torch.tensor(self.index, dtype=torch.float64, device=device) + 0.5) / self.scale


@functools.lru_cache(maxsize=512)
def readout(size: int, scale: float, resize: str) -> Readout:
    """What must be read of one axis so that `size` photo pixels can be developed.

    A point resize looks at 3 (odd scale) or 4 (even scale) pixels of each axis around a photo pixel's centre: no other
    sensor pixel is ever exposed.
    """
    whole = float(scale).is_integer()
    if whole and resize == "point" and scale > 4:
        s = int(scale)
        step = 3 if s % 2 else 4
        first = (s - step) // 2
        lead = first % 2
        index = [s * i + first + k for i in range(size) for k in range(step)]
        index = [index[0] - 1] * lead + index
    else:
        n = max(1, round(size * scale))
        step = int(scale) if whole and (resize == "area" or scale == 1) else 0
        lead, index, scale = 0, list(range(n)), n / size
    if len(index) % 2:
        index.append(index[-1] + 1)
    return Readout(tuple(index), step, lead, size, scale)


def demosaic_bilinear(mosaic: Tensor) -> Tensor:
    """(B, h, w) RGGB mosaic to (B, 3, h, w) as in the paper: the mean of a colour's nearest pixels, zero padded."""
    cross = mosaic.new_tensor([[0.0, 1.0, 0.0], [1.0, 4.0, 1.0], [0.0, 1.0, 0.0]]) / 4
    square = mosaic.new_tensor([[1.0, 2.0, 1.0], [2.0, 4.0, 2.0], [1.0, 2.0, 1.0]]) / 4
    sparse = mosaic.new_zeros(mosaic.shape[0], 3, *mosaic.shape[1:])
    for channel, (r, c) in zip(CHANNELS, CELL, strict=True):
        sparse[:, channel, r::2, c::2] = mosaic[:, r::2, c::2]
    return F.conv2d(sparse, torch.stack([square, cross, square])[:, None], padding=1, groups=3)


def reduce_window(colour: Tensor, step: int, resize: str) -> Tensor:
    """(B, 3, n * step, n * step) to (B, 3, n, n): the mean of each window, or of the pixels around its centre."""
    if resize == "point" and step > 1:
        inner = 1 if step % 2 else 2
        edge = (step - inner) // 2
        windows = colour.unfold(2, step, step).unfold(3, step, step)
        return windows[..., edge : edge + inner, edge : edge + inner].mean((-1, -2))
    return F.avg_pool2d(colour, step)


@functools.lru_cache(maxsize=64)
def folded_kernel(step: int, lead: int, resize: str) -> Tensor:
    """The convolution that demosaics packed planes and resizes by `step`: (3 n n, 4, cells + 2, cells + 2) float64.

    n photo pixels along each axis make a period of whole cells (n = 1 for an even step, 2 for an odd one). The kernel
    is measured: every packed site in reach is lit once, and the two plain steps are run on it.
    """
    n = 1 if step % 2 == 0 else 2
    cells = n * step // 2
    side = cells + 2
    sites = torch.eye(4 * side * side, dtype=torch.float64).reshape(-1, 4, side, side)
    colour = demosaic_bilinear(unpack(sites))[..., 2 + lead : 2 + lead + n * step, 2 + lead : 2 + lead + n * step]
    photo = reduce_window(colour, step, resize)  # (sites, 3, n, n)
    return photo.reshape(-1, 3 * n * n).mT.reshape(3 * n * n, 4, side, side).contiguous()


def develop_mosaic(raw: Tensor, rows: Readout, cols: Readout, resize: str) -> Tensor:
    """Packed raw (B, 4, h / 2, w / 2) to colours (B, 3, H, W): demosaic and resize, both linear.

    Past the border the mosaic is mirrored about its outermost pixels, which keeps colours in place.
    """
    size = (rows.size, cols.size)
    if not (rows.step and cols.step):
        full = (round(rows.size * rows.scale), round(cols.size * cols.scale))
        colour = _fold(raw, 1, 0, "area", full)
        if resize == "area":
            return F.interpolate(colour, size=size, mode="area")
        return F.interpolate(colour, size=size, mode="bilinear", align_corners=False, antialias=resize == "antialias")
    return _fold(raw, rows.step, rows.lead, resize, size)


def _fold(raw: Tensor, step: int, lead: int, resize: str, size: tuple[int, int]) -> Tensor:
    kernel = folded_kernel(step, lead, resize).to(raw)
    n = math.isqrt(kernel.shape[0] // 3)
    cells = n * step // 2
    # whole periods: what the padding adds beyond one cell is cropped again
    more = [max(0, cells * math.ceil(s / n) - have) for s, have in zip(size, raw.shape[-2:], strict=True)]
    padded = F.pad(raw, (1, 1 + more[1], 1, 1 + more[0]), mode="replicate")
    # on CPU a convolution of so few channels is 4 to 6 times faster in channels_last, forth and back
    last = {"memory_format": torch.channels_last}
    photo = F.conv2d(padded.contiguous(**last), kernel.contiguous(**last), stride=cells).contiguous()
    return (F.pixel_shuffle(photo, n) if n > 1 else photo)[..., : size[0], : size[1]]
