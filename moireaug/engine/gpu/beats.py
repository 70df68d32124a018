"""What bins read of the panel's pattern: its harmonics behind the optics, each seen as its aliases;
see `moireaug.camera.exposure.alias_transfer`.

Phases are fractions of a cycle in units of 2^-32, uint32: each bin's are found in float64 once, and
an order times a fraction wraps by itself, without loss.
"""

from __future__ import annotations

import triton
import triton.language as tl
from triton.language.standard import _sum_combine

from moireaug.engine.gpu.arrays import CAMERA_FIELDS
from moireaug.engine.gpu.bins import along, bins_at
from moireaug.engine.gpu.optics import sinc, sinc_within, transfer, wave, wave_of_part
from moireaug.engine.gpu.physics import bind_for_triton
from moireaug.engine.gpu.view import PHOTO_HEIGHT, PHOTO_WIDTH, SCALE_U, SCALE_V

aliases = bind_for_triton("aliases", sinc=sinc)

TURN = tl.constexpr(2.0**32)
PART = tl.constexpr(2.0**-32)


@triton.jit
def fraction(cycles):
    """Return the fraction of a number of cycles, float64, as a phase."""
    return ((cycles - tl.floor(cycles)) * TURN).to(tl.int64).to(tl.uint32)


@triton.jit
def wave_at(phase):
    """Return the cosine and the sine of a phase."""
    return wave_of_part(phase.to(tl.int32, bitcast=True).to(tl.float32) * PART)


@triton.jit
def mean_over_bin(g, bins, triangle):
    """Return what the mean over bins leaves of frequencies along u and v, in cycles per sensor
    pixel; triangle: see `exposure_records.Beats`."""
    first, second = along(g, bins.first), along(g, bins.second)
    passed = aliases.mean_over_sides(1.0, first, second)
    if triangle == 1.0:
        passed *= passed
    else:
        passed = aliases.mean_over_sides(passed, triangle * first, triangle * second)
    return passed


@triton.jit
def even_transfer(fu, fv):
    """Return what interpolation leaves of even aliases of a frequency along u, and along v."""
    (cos_u, _), (cos_v, _) = wave(0.5 * fu), wave(0.5 * fv)
    return cos_u * cos_u, cos_v * cos_v


@triton.jit
def alias_planes(f, m, even, bins, triangle, BAYER: tl.constexpr):
    """Return what is left of an alias m in the planes of red, green and blue, with their signs: by
    holding values over pixels, by the mean over bins and by interpolation.

    Args:
        f: the frequency along u and v. even: from `even_transfer`.
    """
    g = f[0] - 0.5 * m[0], f[1] - 0.5 * m[1]
    passed = sinc_within(g[0]) * sinc_within(g[1]) * mean_over_bin(g, bins, triangle)
    passed = tl.where((tl.abs(g[0]) < 1.0) & (tl.abs(g[1]) < 1.0), passed, 0.0)
    odd_u, odd_v = m[0] % 2 != 0, m[1] % 2 != 0
    if BAYER:
        in_u = aliases.interpolation_transfer(even[0], odd_u)
        in_v = aliases.interpolation_transfer(even[1], odd_v)
        coloured, quincunx = aliases.plane_transfers(in_u, in_v, odd_u, odd_v)
        red, green = passed * coloured, passed * quincunx
        green = tl.where(odd_u, -green, green)
        return red, green, tl.where(odd_u == odd_v, red, -red)
    whole = tl.where(odd_u | odd_v, 0.0, passed)
    return whole, whole, whole


@triton.jit
def plane_waves(j, f, phases, bins, batch, variant: tl.constexpr):
    """Return what the planes of red, green and blue read of the j-th harmonic in front of the
    optics: cosine and sine of each, a tuple of six.

    Args:
        f: its frequency along u and v, cycles per sensor pixel. phases: its own, and those of the
            alias 1 along each axis.
    """
    (carrier, at_u, at_v), none, even = phases, 0.0 * f[0], even_transfer(f[0], f[1])
    waves = none, none, none, none, none, none
    triangle = tl.load(batch.beats.triangle + bins.image)
    starts = batch.terms.alias_start + j
    for t in range(tl.load(starts), tl.load(starts + 1)):
        m_u, m_v = tl.load(batch.terms.alias + 2 * t), tl.load(batch.terms.alias + 2 * t + 1)
        planes, added = alias_planes(f, (m_u, m_v), even, bins, triangle, variant.bayer), ()
        cos, sin = wave_at(carrier - m_u.to(tl.uint32) * at_u - m_v.to(tl.uint32) * at_v)
        for plane in tl.static_range(3):
            added = added + (
                waves[2 * plane] + planes[plane] * cos,
                waves[2 * plane + 1] + planes[plane] * sin,
            )
        waves = added
    return waves


@triton.jit
def responses(bins, batch, variant: tl.constexpr):
    """Return what bins read of a picture of full light in one channel, through a filter that passes
    all of it, by channel and filter: a tuple of nine."""
    image, sensor = bins.image, batch.beats.cameras + bins.image * CAMERA_FIELDS
    start = batch.beats.start + 2 * image
    at_x = fraction((bins.x + tl.load(start)) / variant.period_x)
    at_y = fraction((bins.y + tl.load(start + 1)) / variant.period_y)
    # an alias turns by half a cycle from one sensor pixel to the next; the first is in phase
    from_u = (bins.u + 0.5 * tl.load(sensor + PHOTO_WIDTH)) * tl.load(sensor + SCALE_U) - 0.5
    from_v = (bins.v + 0.5 * tl.load(sensor + PHOTO_HEIGHT)) * tl.load(sensor + SCALE_V) - 0.5
    at_u, at_v = fraction(0.5 * from_u), fraction(0.5 * from_v)
    light, (xu, xv), (yu, yv) = (), bins.step_x, bins.step_y
    for channel in tl.static_range(3):
        mean = tl.load(batch.beats.mean + image * 3 + channel) + 0.0 * xu
        light = light + (mean, mean, mean)
    starts = batch.terms.harmonic_start + image
    for j in range(tl.load(starts), tl.load(starts + 1)):
        h = tl.load(batch.terms.harmonic + j)
        k, l = tl.load(batch.beats.orders + 2 * h), tl.load(batch.beats.orders + 2 * h + 1)
        per_x, per_y = k.to(tl.float32) / variant.period_x, l.to(tl.float32) / variant.period_y
        fu, fv = per_x * xu + per_y * yu, per_x * xv + per_y * yv
        phases = k.to(tl.uint32) * at_x + l.to(tl.uint32) * at_y, at_u, at_v
        waves = plane_waves(j, (fu, fv), phases, bins, batch, variant)
        passed, total = transfer(fu, fv, sensor), ()
        for channel in tl.static_range(3):
            wave_of = batch.beats.coefficients + ((image * 3 + channel) * batch.harmonics + h) * 2
            real, imaginary = passed * tl.load(wave_of), passed * tl.load(wave_of + 1)
            for plane in tl.static_range(3):
                seen = real * waves[2 * plane] - imaginary * waves[2 * plane + 1]
                total = total + (light[3 * channel + plane] + seen,)
        light = total
    return light


@triton.jit
def lost_pattern_variance_kernel(out, batch, variant: tl.constexpr, BLOCK: tl.constexpr):
    """Fill out (B, 3) with the variance of the panel's pattern that bins in the middle average
    away, as a share of the squared mean light, by colour filter: a program an image.

    BLOCK: at least `batch.harmonics`.
    """
    image, h = tl.program_id(0), tl.arange(0, BLOCK)
    valid, none = h < batch.harmonics, 0.0 * h
    middle = none.to(tl.float64)
    bins = bins_at(middle, middle, image, batch, variant)
    orders = batch.beats.orders + 2 * h
    k = tl.load(orders, mask=valid, other=0).to(tl.float32) / variant.period_x
    l = tl.load(orders + 1, mask=valid, other=0).to(tl.float32) / variant.period_y
    (xu, xv), (yu, yv) = bins.step_x, bins.step_y
    fu, fv = k * xu + l * yu, k * xv + l * yv
    first_u, first_v = tl.floor(2.0 * fu).to(tl.int32) - 1, tl.floor(2.0 * fv).to(tl.int32) - 1
    triangle, shares = tl.load(batch.beats.triangle + image), (none, none, none)
    even = even_transfer(fu, fv)
    for i in range(16):
        m = first_u + i // 4, first_v + i % 4
        planes, added = alias_planes((fu, fv), m, even, bins, triangle, variant.bayer), ()
        for plane in tl.static_range(3):
            added = added + (shares[plane] + planes[plane] * planes[plane],)
        shares = added
    passed = transfer(fu, fv, batch.beats.cameras + image * CAMERA_FIELDS)
    for plane in tl.static_range(3):
        real, imaginary, mean = none, none, 0.0
        for channel in tl.static_range(3):
            share = tl.load(batch.exposure.filters + (image * 3 + plane) * 3 + channel)
            wave_of = batch.beats.coefficients + ((image * 3 + channel) * batch.harmonics + h) * 2
            real += share * tl.load(wave_of, mask=valid, other=0.0)
            imaginary += share * tl.load(wave_of + 1, mask=valid, other=0.0)
            mean += share * tl.load(batch.beats.mean + image * 3 + channel)
        lost = 0.5 * passed * passed * tl.maximum(1.0 - shares[plane], 0.0)
        power = tl.reduce(lost * (real * real + imaginary * imaginary), 0, _sum_combine)
        tl.store(out + image * 3 + plane, power / tl.maximum(mean * mean, 1e-12))
