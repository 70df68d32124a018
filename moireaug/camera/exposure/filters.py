"""The sensor's colour filters, whose bands overlap."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from moireaug.common.numeric import library_of, mix_colours
from moireaug.scene.geometry.lattice import CFA, pattern_period
from moireaug.scene.shot import ShotRecord
from moireaug.scene.shot_geometry import ShotGeometry


def crosstalk_matrix(share: Any) -> Any:
    """Return the shares of red, green and blue light that each filter passes, (B, 3, 3), rows by
    filter; each row sums to 1, so that grey stays grey.

    Red and blue filters take a share (B,) of their light from green, green takes half of it from
    each: neighbours in the spectrum overlap, red and blue do not. Of torch or numpy.
    """
    xp = library_of(share)
    none, own, half = xp.zeros_like(share), 1 - share, share / 2
    rows = (own, share, none, half, own, half, none, share, own)
    return xp.stack(rows, -1).reshape(-1, 3, 3)


def filters_of(shot: ShotGeometry) -> Any:
    """Return the shares of red, green and blue light that a shot's filters pass, (B, 3, 3) float64,
    rows by filter."""
    share = shot.sensor.crosstalk
    return crosstalk_matrix(share if "crosstalk" in shot.plan else shot.xp.zeros_like(share))


def filter_cell_seen(shot: ShotRecord) -> str:
    """Return the filter cell, a key of `CFA`, of the colours that pixels see: all three if the
    filters' bands overlap, else their own."""
    return "none" if "crosstalk" in shot.plan else shot.scene.filter_cell


def through_filters(light: Tensor, shot: ShotRecord) -> Tensor:
    """Return the readings (B, 4 or 3, h, w) of the light that pixels see, in the cell that
    `filter_cell_seen` names."""
    if "crosstalk" not in shot.plan:
        return light
    mixed = mix_colours(filters_of(shot), light)
    period, planes = pattern_period(shot.scene.filter_cell), []
    for site in CFA[shot.scene.filter_cell]:
        for channel in site.channels:
            planes.append(mixed[:, channel, site.row :: period, site.column :: period])
    return torch.stack(planes, 1)
