"""Demosaicing: the colours that a Bayer sensor did not read at a pixel, from the pixels around
it."""

from __future__ import annotations

from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor

from moireaug.camera.effects.base import Effect, Verdict, called, left_out
from moireaug.common.numeric import repeat_edges
from moireaug.scene.geometry.lattice import CFA, unpack
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord


class Demosaic(Effect):
    """Packed Bayer planes (B, 4, h / 2, w / 2) to the colours of the pixels that a photo keeps.
    Linear.

    The outermost filter cells are repeated past the border, which keeps the Bayer pattern.
    """

    name = "demosaic"
    mixes_readings = True

    def verdict(self, scene: SceneRecord) -> Verdict:
        if scene.filter_cell == "none":
            return left_out("every pixel reads all colours")
        if scene.is_binned_bayer:
            return called("the two greens of each cell averaged; its pixels were interpolated")
        return called(f"{scene.develop.demosaic}, {scene.sensor.cfa.upper()}")

    def __call__(self, raw: Tensor, shot: ShotRecord) -> Tensor:
        if shot.scene.is_binned_bayer:
            return torch.stack([raw[:, 0], (raw[:, 1] + raw[:, 2]) / 2, raw[:, 3]], 1)
        mosaic = unpack(repeat_edges(raw, 1, 1, 1, 1))
        colours = DEMOSAICS[shot.scene.develop.demosaic](mosaic)[..., 2:-2, 2:-2]
        rows, cols = shot.sampled_pixels()
        return colours[..., rows.of_photo, cols.of_photo]


def demosaic_bilinear(mosaic: Tensor) -> Tensor:
    """Return an RGGB mosaic (B, h, w) as colours (B, 3, h, w): the mean of a colour's nearest
    pixels, zero-padded, as in the paper."""
    cross = mosaic.new_tensor([[0.0, 1.0, 0.0], [1.0, 4.0, 1.0], [0.0, 1.0, 0.0]]) / 4
    square = mosaic.new_tensor([[1.0, 2.0, 1.0], [2.0, 4.0, 2.0], [1.0, 2.0, 1.0]]) / 4
    sparse = mosaic.new_zeros(mosaic.shape[0], 3, *mosaic.shape[1:])
    for site in CFA["rggb"]:
        lattice = (slice(site.row, None, 2), slice(site.column, None, 2))
        sparse[:, site.channels[0], *lattice] = mosaic[:, *lattice]
    return F.conv2d(sparse, torch.stack([square, cross, square])[:, None], padding=1, groups=3)


# Malvar, He and Cutler (2004), figure 2, in eighths: a colour at another's pixel is the mean of its
# neighbours plus a share of the other's curvature.
MALVAR = {
    "green": [
        [0, 0, -1, 0, 0],
        [0, 0, 2, 0, 0],
        [-1, 2, 4, 2, -1],
        [0, 0, 2, 0, 0],
        [0, 0, -1, 0, 0],
    ],
    "along": [
        [0, 0, 0.5, 0, 0],
        [0, -1, 0, -1, 0],
        [-1, 4, 5, 4, -1],
        [0, -1, 0, -1, 0],
        [0, 0, 0.5, 0, 0],
    ],
    "across": [
        [0, 0, -1.5, 0, 0],
        [0, 2, 0, 2, 0],
        [-1.5, 0, 6, 0, -1.5],
        [0, 2, 0, 2, 0],
        [0, 0, -1.5, 0, 0],
    ],
}


def demosaic_malvar(mosaic: Tensor) -> Tensor:
    """Return an RGGB mosaic (B, h, w) as colours (B, 3, h, w), by the filters of Malvar, He and
    Cutler (2004)."""
    kernels = [mosaic.new_tensor(MALVAR[k]) / 8 for k in ("green", "along", "across")]
    kernels.insert(2, kernels[1].mT.contiguous())
    green, beside, below, across = F.conv2d(
        mosaic[:, None], torch.stack(kernels)[:, None], padding=2
    ).unbind(1)
    colour = torch.stack([mosaic] * 3, 1)
    colour[:, 1, 0::2, 0::2], colour[:, 1, 1::2, 1::2] = green[:, 0::2, 0::2], green[:, 1::2, 1::2]
    # red lies beside the greens of its own rows, and above and below those of blue rows; blue the
    # other way round
    for channel, r in ((0, 0), (2, 1)):
        c = 1 - r
        colour[:, channel, r::2, c::2] = beside[:, r::2, c::2]
        colour[:, channel, c::2, r::2] = below[:, c::2, r::2]
        colour[:, channel, c::2, c::2] = across[:, c::2, c::2]
    return colour


DEMOSAICS: dict[str, Callable[[Tensor], Tensor]] = {
    "bilinear": demosaic_bilinear,
    "malvar": demosaic_malvar,
}
