"""The panel's pixels on the picture that is shown.

`display.show` puts the picture on panels of at most its pixels. A finer panel shows what lies
between these: kernels look that up where they need it, and build no panel.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import triton
import triton.language as tl

from moireaug.engine.gpu.display import Shown


class Screen(NamedTuple):
    """What the panels show, or the gradient in it.

    Args:
        light: (B, 3, rows, columns) float32, `display.Shown.light`. lead: see there.
        height, width: of the picture.
    """

    light: Any
    rows: int
    columns: int
    lead: int
    height: int
    width: int


def screen_of(shown: Shown, size: tuple[int, int]) -> Screen:
    """Return the Screen of what is shown of pictures of a height and width."""
    rows, columns = shown.light.shape[2:]
    return Screen(shown.light, rows, columns, shown.lead, *size)


@triton.jit
def channel_start(image, colour, screen):
    """Return the index of the first pixel of one channel of what an image's panel shows."""
    return (image * 3 + colour).to(tl.int64) * screen.rows * screen.columns


@triton.jit
def place_on_shown(position, shown_scale, screen):
    """Return where panel coordinates lie between the centres of pixels shown, 0 for the first;
    float64."""
    return position * shown_scale + (screen.lead - 0.5)


@triton.jit
def split(place, count):
    """Return the pixel before a place, of `count`, int32, and how far it is to the next one,
    float32. Places past the edges count as on them."""
    place = tl.minimum(tl.maximum(place, 0.0), count - 1.0)
    pixel = tl.floor(place)
    return pixel.to(tl.int32), (place - pixel).to(tl.float32)


@triton.jit
def weights_on_shown(first, step, shares, count, TAPS: tl.constexpr, SPAN: tl.constexpr):
    """Return the first of SPAN pixels shown that panel pixels take their light from, and the weight
    of each.

    Args:
        first: place of the first of TAPS panel pixels, from `place_on_shown`. step: float32, from
            one to the next. shares: weights of the panel pixels. count: of pixels shown.
    """
    start = tl.floor(tl.minimum(tl.maximum(first, 0.0), count - 1.0))
    near, low, high = (first - start).to(tl.float32), -start, count - 1.0 - start
    low, high = low.to(tl.float32), high.to(tl.float32)
    weights = ()
    for pixel in tl.static_range(SPAN):
        weight = 0.0 * near
        for tap in tl.static_range(TAPS):
            place = tl.minimum(tl.maximum(near + step * tap, low), high)
            weight += shares[tap] * tl.maximum(1.0 - tl.abs(place - pixel), 0.0)
        weights = weights + (weight,)
    return start.to(tl.int32), weights


@triton.jit
def content(light, left, top, across, down, screen, COLUMNS: tl.constexpr, ROWS: tl.constexpr):
    """Return the sum of the pixels shown from a column and row on, times the weights of columns and
    rows; light: of one channel."""
    total = 0.0 * across[0]
    for m in tl.static_range(ROWS):
        line = light + tl.minimum(top + m, screen.rows - 1) * screen.columns
        from_row = 0.0 * total
        for n in tl.static_range(COLUMNS):
            pixel = tl.minimum(left + n, screen.columns - 1)
            from_row += across[n] * tl.load(line + pixel)
        total += down[m] * from_row
    return total


@triton.jit
def scatter(
    light_grad, back, left, top, across, down, inside, screen,
    COLUMNS: tl.constexpr, ROWS: tl.constexpr,
):  # fmt: skip
    """Add the gradient in pixels shown, from that in their `content`."""
    for m in tl.static_range(ROWS):
        line = light_grad + tl.minimum(top + m, screen.rows - 1) * screen.columns
        for n in tl.static_range(COLUMNS):
            weight = down[m] * across[n]
            pixel = tl.minimum(left + n, screen.columns - 1)
            tl.atomic_add(line + pixel, back * weight, mask=inside & (weight != 0.0))
