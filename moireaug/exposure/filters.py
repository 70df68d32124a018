"""The sensor's colour filters, whose bands overlap."""

from __future__ import annotations

import torch
from torch import Tensor

from moireaug.geometry.sensor import CFA, cell
from moireaug.numeric import mix_colours


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


def colours_seen(shot) -> str:
    """Return the filter cell, a key of `CFA`, of the colours that pixels see: all three if the
    filters' bands overlap, else their own."""
    return "none" if "crosstalk" in shot.plan else shot.scene.cells


def through_filters(light: Tensor, shot) -> Tensor:
    """Return the readings (B, 4 or 3, h, w) of the light that pixels see, in the cell that
    `colours_seen` names."""
    if "crosstalk" not in shot.plan:
        return light
    mixed = mix_colours(crosstalk_matrix(shot.sensor.crosstalk), light)
    cfa, planes = shot.scene.cells, []
    for site in CFA[cfa]:
        for channel in site.channels:
            planes.append(mixed[:, channel, site.row :: cell(cfa), site.column :: cell(cfa)])
    return torch.stack(planes, 1)
