"""What bins see of the picture: a Patch of the pixels that are shown."""

from __future__ import annotations

import triton
import triton.language as tl

from moireaug.engine.gpu.arrays import CAMERA_FIELDS
from moireaug.engine.gpu.bins import along
from moireaug.engine.gpu.footprint import MIN_BLUR_VARIANCE, View, lit_shares
from moireaug.engine.gpu.panel import Patch
from moireaug.engine.gpu.transfer import blur_variance


@triton.jit
def _along_axis(channel, position, step, bins, batch, AXIS: tl.constexpr, variant: tl.constexpr):
    """Return the first pixel shown that bins see along one axis, in one channel, and the weights of
    `variant.taps`.

    Args:
        position: panel coordinates, float64. step: their change per sensor pixel along u and v.
    """
    lens, index = batch.lenses + bins.image * CAMERA_FIELDS, (bins.image * 3 + channel) * 2 + AXIS
    ratio = tl.load(batch.ratio + bins.image)
    by_u, by_v = step[0] * (1.0 / ratio), step[1] * (1.0 / ratio)
    one = tl.abs(along((by_u, by_v), bins.first))
    other = tl.abs(along((by_u, by_v), bins.second))
    short, hold = tl.minimum(one, other), tl.load(batch.hold + bins.image) + MIN_BLUR_VARIANCE
    variance = short * short / 12.0 + blur_variance(by_u, by_v, lens) + hold
    view = View(tl.maximum(one, other), tl.sqrt(variance))
    place = position * (1.0 / ratio.to(tl.float64)) - tl.load(batch.centres + index)
    end = batch.screen.size[AXIS] * tl.load(batch.display.pixel_scale + bins.image)
    nearest, _, shares = lit_shares(
        place, view, tl.load(batch.widths + index), (place + 0.5, 0.5, end), variant.taps,
        variant.dark,
    )  # fmt: skip
    return nearest.to(tl.int32) + (batch.screen.lead - variant.taps // 2), shares


@triton.jit
def patch_of(channel, bins, batch, variant: tl.constexpr):
    """Return the Patch that bins see in one channel."""
    left, across = _along_axis(channel, bins.x, bins.step_x, bins, batch, 0, variant)
    top, down = _along_axis(channel, bins.y, bins.step_y, bins, batch, 1, variant)
    return Patch(left, top, across, down)
