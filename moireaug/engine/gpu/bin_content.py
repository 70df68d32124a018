"""What bins see of the picture: how much of each pixel of the panel that is shown, and the
transpose."""

from __future__ import annotations

from typing import Any, NamedTuple

import triton
import triton.language as tl

from moireaug.engine.gpu.arrays import CAMERA_FIELDS
from moireaug.engine.gpu.footprint import (
    MIN_BLUR_VARIANCE,
    NEAREST_GUARD_SHARE,
    narrowing,
    share_between,
    share_beyond,
)
from moireaug.engine.gpu.transfer import blur_variance

FAR_SIGMAS = tl.constexpr(8.0)  # beyond which no light is


class Screen(NamedTuple):
    """What panels show, or the gradient in it.

    Args:
        light: (B, 3, rows, columns) float32. lead: of its pixels ahead of the picture; see
            `display.Shown`.
        pixel_scale: (B,) float32, pixels of the panel per pixel of the picture.
    """

    light: Any
    rows: Any
    columns: Any
    lead: Any
    pixel_scale: Any


class Along(NamedTuple):
    """What bins see along one axis of the panel that is shown, in its pixels.

    Args:
        nearest: int32, the pixel that is nearest. offset: from its light's middle. box, sigma: of
            the view, narrowed to the taps. width: of a pixel's light.
        end: of the picture. on_picture: share of the view that is on it, or -1 where the view is
            not narrowed, and taps are on it or not.
    """

    nearest: Any
    offset: Any
    box: Any
    sigma: Any
    width: Any
    end: Any
    on_picture: Any


@triton.jit
def view_along(at, along, bins, lens, width, hold, end, variant: tl.constexpr):
    """Return what bins see Along one axis.

    Args:
        at: float64, where they look, from the middle of the light of the pixel 0, in pixels.
        along: pixels per sensor pixel along u and v. lens: pointer to its Camera.
        width, end: see `Along`. hold: see `bins.Batch`.
    """
    by_u, by_v = along
    one = tl.abs(by_u * bins.first_u + by_v * bins.first_v)
    other = tl.abs(by_u * bins.second_u + by_v * bins.second_v)
    box, short = tl.maximum(one, other), tl.minimum(one, other)
    variance = short * short / 12.0 + blur_variance(by_u, by_v, lens) + hold + MIN_BLUR_VARIANCE
    sigma = tl.sqrt(variance)
    narrowed, nearest = narrowing(box, sigma, width, variant.taps), tl.floor(at + 0.5)
    on_picture = 0.0 * box - 1.0
    if variant.dark:
        far = 0.5 * box + FAR_SIGMAS * sigma
        to_start, to_end = (at + 0.5).to(tl.float32), (at + 0.5 - end).to(tl.float32)
        past_start = share_beyond(-tl.minimum(tl.maximum(to_start, -far), far), box, sigma)
        past_end = share_beyond(-tl.minimum(tl.maximum(to_end, -far), far), box, sigma)
        on_picture = tl.where(narrowed < 1.0, past_start - past_end, on_picture)
    offset, nearest = (at - nearest).to(tl.float32), nearest.to(tl.int32)
    return Along(nearest, offset, box * narrowed, sigma * narrowed, width, end, on_picture)


@triton.jit
def views_of(channel, image, bins, batch, screen, variant: tl.constexpr):
    """Return what bins see Along x and y, in one channel."""
    lens, ratio = batch.lenses + image * CAMERA_FIELDS, tl.load(batch.ratio + image)
    place, hold = (image * 3 + channel) * 2, tl.load(batch.hold + image)
    scale, by, exact = tl.load(screen.pixel_scale + image), 1.0 / ratio, 1.0 / ratio.to(tl.float64)
    middle_x, middle_y = tl.load(batch.centres + place), tl.load(batch.centres + place + 1)
    width_x, width_y = tl.load(batch.widths + place), tl.load(batch.widths + place + 1)
    x = view_along(
        bins.x * exact - middle_x, (bins.xu * by, bins.xv * by),
        bins, lens, width_x, hold, batch.width * scale, variant,
    )  # fmt: skip
    y = view_along(
        bins.y * exact - middle_y, (bins.yu * by, bins.yv * by),
        bins, lens, width_y, hold, batch.height * scale, variant,
    )  # fmt: skip
    return x, y


@triton.jit
def share_of(tap, view, variant: tl.constexpr):
    """Return the share of a tap in the light of all, up to a factor, and how much of it is on the
    picture."""
    away = tap - variant.taps // 2
    share = share_between(away - view.offset, 0.5 * view.width, view.box, view.sigma)
    share += tl.where(away == 0, NEAREST_GUARD_SHARE, 0.0)
    on_picture = 1.0
    if variant.dark:
        pixel = view.nearest + away
        alone = tl.where((pixel >= 0) & (pixel + 0.5 < view.end), 1.0, 0.0)
        on_picture = tl.where(view.on_picture < 0.0, alone, view.on_picture)
    return share, share * on_picture


@triton.jit
def place_of(tap, view, count, lead, variant: tl.constexpr):
    """Return the place of a tap among `count` pixels that are shown along an axis; beyond them,
    that of the outermost."""
    return tl.minimum(tl.maximum(view.nearest + (tap - variant.taps // 2) + lead, 0), count - 1)


@triton.jit
def shares_across(view, screen, variant: tl.constexpr):
    """Return the shares of all taps of a view along x, a tuple, their places, and the factor that
    makes them sum to 1."""
    shares, places, total = (), (), 0.0 * view.offset
    for tap in tl.static_range(variant.taps):
        share, lit = share_of(tap, view, variant)
        shares, total = shares + (lit,), total + share
        places = places + (place_of(tap, view, screen.columns, screen.lead, variant),)
    return shares, places, 1.0 / total


@triton.jit
def content(channel, image, x, y, screen, valid, variant: tl.constexpr):
    """Return what bins see of one channel, from what they see Along x and y."""
    light = screen.light + (image * 3 + channel).to(tl.int64) * screen.rows * screen.columns
    across, columns, factor = shares_across(x, screen, variant)
    seen, total = 0.0 * factor, 0.0 * factor
    for tap in range(variant.taps):
        share, lit = share_of(tap, y, variant)
        row = place_of(tap, y, screen.rows, screen.lead, variant) * screen.columns
        line = 0.0 * factor
        for i in tl.static_range(variant.taps):
            line += across[i] * tl.load(light + row + columns[i], mask=valid, other=0.0)
        seen, total = seen + lit * line, total + share
    return seen * factor / total


@triton.jit
def add_content_back(grad, channel, image, x, y, screen, valid, variant: tl.constexpr):
    """Add to the gradient in what panels show, which screen holds, that of bins' content."""
    light = screen.light + (image * 3 + channel).to(tl.int64) * screen.rows * screen.columns
    across, columns, factor = shares_across(x, screen, variant)
    total = 0.0 * factor
    for tap in range(variant.taps):
        share, _ = share_of(tap, y, variant)
        total += share
    factor *= grad / total
    for tap in range(variant.taps):
        _, lit = share_of(tap, y, variant)
        row = place_of(tap, y, screen.rows, screen.lead, variant) * screen.columns
        for i in tl.static_range(variant.taps):
            back = factor * lit * across[i]
            tl.atomic_add(light + row + columns[i], back, mask=valid & (back != 0.0))
