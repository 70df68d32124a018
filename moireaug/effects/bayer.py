"""The sensor's lattice: which of its pixels are read, which colour each has, and how they become a photo.

Raw readings of a Bayer sensor are kept packed, `(B, 4, h / 2, w / 2)`, in the order R, G, G, B of the RGGB cell; those
of a sensor without colour filters are `(B, 3, h, w)`. Demosaicing, and an area or point resize by a whole factor, are
linear and repeat with the cell; so they are folded into one convolution of the packed planes, whose kernel is read off
the two steps themselves.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

CELL = ((0, 0), (0, 1), (1, 0), (1, 1))  # (row, column) of the planes R, G, G, B
CHANNELS = (0, 1, 1, 2)
SITES: dict[str, tuple[tuple[int, int, tuple[int, ...]], ...]] = {  # row and column in the cell, channels read there
    "rggb": tuple((r, c, (channel,)) for (r, c), channel in zip(CELL, CHANNELS, strict=True)),
    "none": ((0, 0, (0, 1, 2)),),
}


def stride(cfa: str) -> int:
    """Sensor pixels from one cell to the next."""
    return 2 if len(SITES[cfa]) > 1 else 1


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
def readout(size: int, scale: float, resize: str, reach: int) -> Readout:
    """What must be read of one axis so that `size` photo pixels can be developed.

    A point resize looks at 1 (odd scale) or 2 (even scale) pixels of each axis in a photo pixel's centre, and
    demosaicing `reach` pixels around them; a reach of 0 is a sensor without a cell. No other pixel is ever exposed.
    """
    whole, cell = float(scale).is_integer(), 2 if reach else 1
    step = (1 if scale % 2 else 2) + 2 * reach
    if whole and resize == "point" and scale > step:
        s = int(scale)
        first = (s - step) // 2
        lead = first % cell
        index = [s * i + first + k for i in range(size) for k in range(step)]
        index = [index[0] - 1] * lead + index
    else:
        n = max(1, round(size * scale))
        step = int(scale) if whole and (resize == "area" or scale == 1) else 0
        lead, index, scale = 0, list(range(n)), n / size
    if len(index) % cell:
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


# Malvar, He and Cutler (2004), figure 2, in eighths: a colour at another's pixel is the mean of its neighbours plus
# a share of the other's curvature.
MALVAR = {
    "green": [[0, 0, -1, 0, 0], [0, 0, 2, 0, 0], [-1, 2, 4, 2, -1], [0, 0, 2, 0, 0], [0, 0, -1, 0, 0]],
    "along": [[0, 0, 0.5, 0, 0], [0, -1, 0, -1, 0], [-1, 4, 5, 4, -1], [0, -1, 0, -1, 0], [0, 0, 0.5, 0, 0]],
    "across": [[0, 0, -1.5, 0, 0], [0, 2, 0, 2, 0], [-1.5, 0, 6, 0, -1.5], [0, 2, 0, 2, 0], [0, 0, -1.5, 0, 0]],
}


def demosaic_malvar(mosaic: Tensor) -> Tensor:
    """(B, h, w) RGGB mosaic to (B, 3, h, w) by the linear filters of Malvar, He and Cutler (2004)."""
    kernels = [mosaic.new_tensor(MALVAR[k]) / 8 for k in ("green", "along", "across")]
    kernels.insert(2, kernels[1].mT.contiguous())
    green, beside, below, across = F.conv2d(mosaic[:, None], torch.stack(kernels)[:, None], padding=2).unbind(1)
    colour = torch.stack([mosaic] * 3, 1)
    colour[:, 1, 0::2, 0::2], colour[:, 1, 1::2, 1::2] = green[:, 0::2, 0::2], green[:, 1::2, 1::2]
    # red lies beside the greens of its own rows and below and above those of blue's; blue the other way round
    for channel, r in ((0, 0), (2, 1)):
        c = 1 - r
        colour[:, channel, r::2, c::2] = beside[:, r::2, c::2]
        colour[:, channel, c::2, r::2] = below[:, c::2, r::2]
        colour[:, channel, c::2, c::2] = across[:, c::2, c::2]
    return colour


DEMOSAICS: dict[str, Callable[[Tensor], Tensor]] = {"bilinear": demosaic_bilinear, "malvar": demosaic_malvar}
REACH = {"bilinear": 1, "malvar": 2}  # sensor pixels that a colour is made from, to each side


@functools.lru_cache(maxsize=64)
def folded_kernel(step: int, lead: int, resize: str, demosaic: str) -> Tensor:
    """The convolution that demosaics packed planes and resizes by `step`: (3 n n, 4, side, side) float64.

    n photo pixels along each axis make a period of whole cells (n = 1 for an even step, 2 for an odd one), which the
    kernel reaches beyond by one cell. It is measured: every packed site in reach is lit once, and the two plain steps
    are run on it.
    """
    n = 1 if step % 2 == 0 else 2
    side = n * step // 2 + 2 + lead
    sites = torch.eye(4 * side * side, dtype=torch.float64).reshape(-1, 4, side, side)
    window = slice(2 + lead, 2 + lead + n * step)
    photo = reduce_window(DEMOSAICS[demosaic](unpack(sites))[..., window, window], step, resize, REACH[demosaic])
    return photo.reshape(-1, 3 * n * n).mT.reshape(3 * n * n, 4, side, side).contiguous()


def develop_mosaic(raw: Tensor, rows: Readout, cols: Readout, resize: str, demosaic: str) -> Tensor:
    """Packed raw (B, 4, h / 2, w / 2) to colours (B, 3, H, W): demosaic and resize, both linear.

    Past the border the mosaic is mirrored about its outermost pixels, which keeps colours in place.
    """
    if rows.step and cols.step:
        return _fold(raw, rows.step, rows.lead, resize, demosaic, (rows.size, cols.size))
    return resize_colour(demosaic_all(raw, rows, cols, demosaic), rows, cols, resize)


def demosaic_all(raw: Tensor, rows: Readout, cols: Readout, demosaic: str) -> Tensor:
    """Packed raw of a whole sensor to colours at each of its pixels."""
    return _fold(raw, 1, 0, "area", demosaic, tuple(round(r.size * r.scale) for r in (rows, cols)))


def resize_colour(colour: Tensor, rows: Readout, cols: Readout, resize: str) -> Tensor:
    """Colours (B, 3, h, w) of the pixels that were read to photo pixels (B, 3, H, W)."""
    size = (rows.size, cols.size)
    if rows.step and cols.step:
        return reduce_window(colour, rows.step, resize, 0)
    if resize == "area":
        return F.interpolate(colour, size=size, mode="area")
    return F.interpolate(colour, size=size, mode="bilinear", align_corners=False, antialias=resize == "antialias")


def reduce_window(colour: Tensor, step: int, resize: str, reach: int) -> Tensor:
    """(B, 3, n * step, n * step) to (B, 3, n, n): the mean of each window, or of the pixels around its centre, which a
    point resize reads with `reach` more to each side."""
    if step == 1:
        return colour
    if resize == "point":
        windows = colour.unfold(2, step, step).unfold(3, step, step)
        return windows[..., reach : step - reach, reach : step - reach].mean((-1, -2))
    return F.avg_pool2d(colour, step)


def _fold(raw: Tensor, step: int, lead: int, resize: str, demosaic: str, size: tuple[int, int]) -> Tensor:
    kernel = folded_kernel(step, lead, resize, demosaic).to(raw)
    n = math.isqrt(kernel.shape[0] // 3)
    cells = n * step // 2
    # whole periods: what the padding adds beyond one cell is cropped again
    more = [max(0, cells * math.ceil(s / n) + lead - have) for s, have in zip(size, raw.shape[-2:], strict=True)]
    padded = F.pad(raw, (1, 1 + more[1], 1, 1 + more[0]), mode="replicate")
    # on CPU a convolution of so few channels is 4 to 6 times faster in channels_last, forth and back
    last = {"memory_format": torch.channels_last}
    photo = F.conv2d(padded.contiguous(**last), kernel.contiguous(**last), stride=cells).contiguous()
    # as F.pixel_shuffle, which has no gradient for an empty batch
    photo = photo.unflatten(1, (3, n, n)).permute(0, 1, 4, 2, 5, 3).flatten(4, 5).flatten(2, 3)
    return photo[..., : size[0], : size[1]]
