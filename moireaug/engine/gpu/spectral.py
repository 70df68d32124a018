"""Screen to raw by the panel's light over each sensor pixel's aperture and blur, in full readings:
the exposures "spectral" and "mean".

What a pixel sees of a subpixel is what the cells around show, weighted by their shares of the
pixel's view, times the sum of the subpixel's harmonics, each weighted by its transfer.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import triton
import triton.language as tl

from moireaug.engine.gpu.footprint import footprint_of, lit_shares
from moireaug.engine.gpu.optics import transfer, wave
from moireaug.engine.gpu.patch import Patch, place_on_shown, weights_on_shown
from moireaug.engine.gpu.view import ALPHA
from moireaug.engine.lower.exposure_records import Camera, Exposure, FullView

BLOCK = 256  # pixels of a plane that one program computes, so that no compiler spills registers


class Subpixels(NamedTuple):
    """What the method reads of a panel's subpixels, of some kinds; see `exposure_records.Cell`.

    Args:
        cells: (kinds, 2) float64, per panel pixel. width, added_variance: (B, kinds, 2) float32,
            see `exposure_records.FullView`.
        k, l: (terms,) float32, of harmonics, those of each kind together. first_term: (kinds + 1,)
            int32. amplitude: (B, terms) float32. mean: (B, kinds) float32.
        kinds, terms: how many there are.
    """

    cells: Any
    width: Any
    added_variance: Any
    k: Any
    l: Any
    first_term: Any
    amplitude: Any
    mean: Any
    kinds: int
    terms: int


def subpixels_of(e: Exposure, view: FullView) -> Subpixels:
    """Return an exposure's Subpixels, of arrays."""
    middle, kinds = view.coefficients.shape[3] // 2, len(e.cell.period)
    amplitude = view.coefficients.copy()
    amplitude[:, :, 0, middle] = 0
    # each image's by itself, so that its reading does not depend on the rest of the batch
    gain = np.maximum(e.cameras[:, Camera._fields.index("gain")], 1)[:, None, None, None]
    amplitude[np.abs(amplitude) <= e.budget.harmonic_amplitude / gain] = 0
    kind, k, l = np.nonzero(amplitude.any(0))
    return Subpixels(
        cells=1 / e.cell.period,
        width=view.widths,
        added_variance=view.added_variance,
        k=k.astype(np.float32),
        l=(l - middle).astype(np.float32),
        first_term=np.searchsorted(kind, np.arange(kinds + 1)),
        amplitude=amplitude[:, kind, k, l],
        mean=view.coefficients[:, :, 0, middle],
        kinds=kinds,
        terms=len(k),
    )


def span_of(e: Exposure) -> tuple[int, int]:
    """Return how many columns and rows of pixels shown a pixel's cells take their light from, at
    most: a finer panel's pixels from two each."""
    alpha = np.maximum(e.cameras[:, Camera._fields.index("alpha")], 1)
    from_first_to_last = 2 * e.cell.radius * e.cell.period.max(0) / int(alpha.min())
    columns, rows = np.ceil(from_first_to_last).astype(int) + (2 if alpha.max() > 1 else 1)
    return int(columns), int(rows)


@triton.jit
def _along_axis(i, sight, site, batch, AXIS: tl.constexpr, variant: tl.constexpr):
    """Return, along one axis, how far pixels look past the nearest subpixel i, in cells, the first
    pixel shown that they see, and the weights of `variant.span`.

    sight: panel coordinates, float64, and their change per sensor pixel along u and v.
    """
    exposure, subpixels, screen = batch.exposure, batch.subpixels, batch.screen
    position, (by_u, by_v) = sight
    kind, index = tl.load(exposure.cell.kind + i), 2 * i + AXIS
    period = tl.load(exposure.cell.period + 2 * kind + AXIS).to(tl.float32)
    cells = tl.load(subpixels.cells + 2 * kind + AXIS)
    shape = (site.image * subpixels.kinds + kind) * 2 + AXIS
    width, added_variance = subpixels.width + shape, tl.load(subpixels.added_variance + shape)
    footprint = footprint_of(by_u, by_v, period, added_variance, site.camera)
    place = (position - tl.load(exposure.cell.centre + index)) * cells
    pixel = tl.load(exposure.cell.pixel + index) + 0.5
    end = tl.load(site.camera + ALPHA) * screen.size[AXIS]
    picture = position * cells, pixel * cells, end * cells
    nearest, offset, shares = lit_shares(
        place, footprint, tl.load(width), picture, variant.taps, variant.dark_around
    )
    first_position = (nearest - variant.taps // 2) * period + pixel
    first = place_on_shown(first_position, site.shown_scale, screen)
    step = (period * site.shown_scale).to(tl.float32)
    start, weights = weights_on_shown(first, step, shares, screen.pixels[AXIS], variant.span[AXIS])
    return offset, start, weights


@triton.jit
def _modulation(i, x, y, steps, site, batch):
    """Return the light of subpixels i on a white picture, at offsets in cells from the nearest.

    steps: change of panel x and of panel y per sensor pixel along u and v.
    """
    kind, ((xu, xv), (yu, yv)) = tl.load(batch.exposure.cell.kind + i), steps
    subpixels = batch.subpixels
    cells_x = tl.load(subpixels.cells + 2 * kind).to(tl.float32)
    cells_y = tl.load(subpixels.cells + 2 * kind + 1).to(tl.float32)
    light = 0.0 * x + tl.load(subpixels.mean + site.image * subpixels.kinds + kind)
    last = tl.load(subpixels.first_term + kind + 1)
    for term in range(tl.load(subpixels.first_term + kind), last):
        k, l = tl.load(subpixels.k + term), tl.load(subpixels.l + term)
        amplitude = tl.load(subpixels.amplitude + site.image * subpixels.terms + term)
        fx, fy = k * cells_x, l * cells_y
        passed = transfer(fx * xu + fy * yu, fx * xv + fy * yv, site.camera)
        light += amplitude * passed * wave(k * x + l * y)[0]
    return light


@triton.jit
def see(i, sight, site, batch, variant: tl.constexpr):
    """Return what pixels see of subpixels i: their light on a white picture, and the Patch of
    pixels shown that it comes from; sight: from `sensor_sites.look_at_panel`."""
    x, left, across = _along_axis(i, sight[0], site, batch, 0, variant)
    y, top, down = _along_axis(i, sight[1], site, batch, 1, variant)
    light = _modulation(i, x, y, (sight[0][1], sight[1][1]), site, batch)
    return light, Patch(left, top, across, down)
