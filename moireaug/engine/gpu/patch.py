"""The pixels of a `panel.Screen` that sensor pixels see, and the light of these."""

from __future__ import annotations

from typing import Any, NamedTuple

import triton
import triton.language as tl


class Patch(NamedTuple):
    """Pixels shown: their first column and row, int32, which may be beyond the edge, and the
    weights of as many columns and rows as there are weights."""

    left: Any
    top: Any
    across: Any
    down: Any


@triton.jit
def channel_of(light, image, colour, screen):
    """Return a pointer to one channel of an image on the screen, or of the gradient in it."""
    return light + (image * 3 + colour) * screen.pixels[0] * screen.pixels[1]


@triton.jit
def within(first, offset, count):
    """Return pixels at an offset from the first, of `count`, or the outermost beyond the edges."""
    return tl.minimum(tl.maximum(first + offset, 0), count - 1)


@triton.jit
def content(channel, patch, screen):
    """Return the light of a Patch: the weighted sum of its pixels."""
    columns, rows = screen.pixels
    total = 0.0 * patch.across[0]
    for m in tl.static_range(len(patch.down)):
        line = channel + within(patch.top, m, rows) * columns
        of_row = 0.0 * total
        for n in tl.static_range(len(patch.across)):
            of_row += patch.across[n] * tl.load(line + within(patch.left, n, columns))
        total += patch.down[m] * of_row
    return total


@triton.jit
def add_content_back(channel, grad, patch, inside, screen):
    """Add the gradient in pixels shown to a channel, from that in their `content`."""
    columns, rows = screen.pixels
    for m in tl.static_range(len(patch.down)):
        line = channel + within(patch.top, m, rows) * columns
        for n in tl.static_range(len(patch.across)):
            back = grad * patch.down[m] * patch.across[n]
            at = line + within(patch.left, n, columns)
            tl.atomic_add(at, back, mask=inside & (back != 0.0))
