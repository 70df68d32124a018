"""The sensor's lattice: which of its pixels a photo reads, and which colour each has.

Raw readings of a Bayer sensor are kept packed, `(B, 4, h / 2, w / 2)`, in the order R, G, G, B of
the RGGB cell; those of a sensor without colour filters are `(B, 3, h, w)`.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor


class Site(NamedTuple):
    """One pixel of the filter cell: its row and column there, and the channels that it reads."""

    row: int
    column: int
    channels: tuple[int, ...]


CFA: dict[str, tuple[Site, ...]] = {
    "rggb": (Site(0, 0, (0,)), Site(0, 1, (1,)), Site(1, 0, (1,)), Site(1, 1, (2,))),
    "none": (Site(0, 0, (0, 1, 2)),),
    "binned": (Site(0, 0, (0, 1, 1, 2)),),  # a whole cell for each photo pixel
}


def pattern_period(cfa: str) -> int:
    """Return the number of sensor pixels along each side of the filter cell."""
    return 2 if cfa == "rggb" else 1


def pack(mosaic: Tensor) -> Tensor:
    """Return a mosaic (B, h, w) with even h and w as packed planes (B, 4, h / 2, w / 2)."""
    return torch.stack([mosaic[:, site.row :: 2, site.column :: 2] for site in CFA["rggb"]], 1)


def unpack(raw: Tensor) -> Tensor:
    """Return packed planes (B, 4, h / 2, w / 2) as the mosaic (B, h, w)."""
    b, _, h, w = raw.shape
    # not pixel_shuffle, whose gradient fails on an empty batch
    return raw.reshape(b, 2, 2, h, w).permute(0, 3, 1, 4, 2).reshape(b, 2 * h, 2 * w)


@dataclass(frozen=True)
class SampledPixels:
    """The sensor rows (or columns) that a photo reads, and how they map to its pixels.

    index: the sensor pixels that are read; each has the parity of its place in the tuple.
    step: pixels read per photo pixel; 0 where the resize interpolates over all pixels.
    lead: pixels read before the first photo pixel's own.
    size: photo pixels. scale: sensor pixels per photo pixel.
    """

    index: tuple[int, ...]
    step: int
    lead: int
    size: int
    scale: float

    @property
    def count(self) -> int:
        """How many of the pixels make up photo pixels; the others complete filter cells."""
        return self.size * self.step if self.step else max(1, round(self.size * self.scale))

    @property
    def of_photo(self) -> slice:
        """The places in `index` of the pixels that make up photo pixels."""
        return slice(self.lead, self.lead + self.count)

    def positions(self, device: torch.device | str = "cpu") -> Tensor:
        """Return the photo coordinates of the pixels' centres, (len(index),) float64."""
        return (torch.tensor(self.index, dtype=torch.float64, device=device) + 0.5) / self.scale


@functools.lru_cache(maxsize=512)
def binned_pixels(size: int) -> SampledPixels:
    """Return the cells along one axis of a binned reading: one for each photo pixel."""
    return SampledPixels(tuple(range(size)), 1, 0, size, 1.0)


@functools.lru_cache(maxsize=512)
def sampled_pixels(size: int, scale: float, resize: str, reach: int) -> SampledPixels:
    """Return which pixels must be read along one axis to develop `size` photo pixels.

    A point resize needs 1 (odd scale) or 2 (even scale) pixels in each photo pixel's centre, and
    demosaicing `reach` pixels to each side of them; a reach of 0 is a sensor without a filter cell.
    At a whole scale above their number, no other is read; else, or of the resize "all", all are.
    """
    whole, side = float(scale).is_integer(), 2 if reach else 1
    step = (1 if scale % 2 else 2) + 2 * reach
    if whole and resize == "point" and scale > step:
        s = int(scale)
        first = (s - step) // 2
        lead = first % side
        index = [s * i + first + k for i in range(size) for k in range(step)]
        index = [index[0] - 1] * lead + index
    else:
        n = max(1, round(size * scale))
        step = int(scale) if whole and (resize == "area" or scale == 1) else 0
        lead, index, scale = 0, list(range(n)), n / size
    if len(index) % side:
        index.append(index[-1] + 1)
    return SampledPixels(tuple(index), step, lead, size, scale)
