"""The sensor's colour filters, whose bands overlap."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from moireaug.geometry.sensor import Site


def crosstalk_matrix(share: Tensor) -> Tensor:
    """Return what each filter passes of red, green and blue light, (B, 3, 3), rows by filter; each
    row sums to 1, so that grey stays grey.

    Red and blue filters take a share (B,) of their light from green, green takes half of it from
    each: neighbours in the spectrum overlap, red and blue do not.
    """
    none, own, half = torch.zeros_like(share), 1 - share, share / 2
    red = torch.stack([own, share, none], -1)
    green = torch.stack([half, own, half], -1)
    blue = torch.stack([none, share, own], -1)
    return torch.stack([red, green, blue], -2)


def through_filters(read: Callable[[int], Tensor], site: Site, shot) -> list[Tensor]:
    """Return what a site reads through each of its filters, (B, h, w) each. `read(channel)` is what
    it would read of one colour alone."""
    if "crosstalk" not in shot.plan:
        return [read(channel) for channel in site.channels]
    light = torch.stack([read(channel) for channel in range(3)], 1)
    mix = crosstalk_matrix(shot.sensor.crosstalk).to(light.dtype)
    seen = torch.einsum("bij,bjhw->ibhw", mix, light)
    return [seen[channel] for channel in site.channels]
