"""What bins read of the panel's pattern: its harmonics behind the optics, each seen as its aliases;
see `moireaug.exposure.alias_transfer`.

Phases are fractions of a cycle in units of 2^-32, uint32: each bin's are found in float64 once, and
an order times a fraction wraps by itself, without loss.
"""

from __future__ import annotations

import triton
import triton.language as tl

from moireaug.engine.gpu.arrays import CAMERA_FIELDS
from moireaug.engine.gpu.bins import bins_at
from moireaug.engine.gpu.transfer import sinc, transfer, wave, wave_of_part
from moireaug.engine.gpu.view import SCALE_U, SCALE_V

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
def mean_over_bin(g_u, g_v, bins, triangle):
    """Return what the mean over bins leaves of frequencies in cycles per sensor pixel; triangle:
    see `exposure_records.Beats`."""
    first = g_u * bins.first_u + g_v * bins.first_v
    second = g_u * bins.second_u + g_v * bins.second_v
    left = sinc(first) * sinc(second)
    return left * sinc(triangle * first) * sinc(triangle * second)


@triton.jit
def plane_transfers(even_u, even_v, m_u, m_v, BAYER: tl.constexpr):
    """Return what interpolation leaves of an alias in the planes of red, green and blue, with their
    signs; even: what it leaves along an axis of even aliases."""
    odd_u, odd_v = m_u % 2 != 0, m_v % 2 != 0
    if BAYER:
        in_u, in_v = tl.where(odd_u, 1.0 - even_u, even_u), tl.where(odd_v, 1.0 - even_v, even_v)
        red, mean = in_u * in_v, 0.5 * (in_u + in_v)
        green = tl.where(odd_u == odd_v, tl.where(odd_u, -mean, mean), 0.0)
        blue = tl.where(odd_u == odd_v, red, -red)
        return red, green, blue
    whole = tl.where(odd_u | odd_v, 0.0, 1.0) + 0.0 * even_u
    return whole, whole, whole


@triton.jit
def alias_transfer(fu, fv, m_u, m_v, bins, triangle):
    """Return what holding values over pixels and the mean over bins leave of an alias."""
    g_u, g_v = fu - 0.5 * m_u, fv - 0.5 * m_v
    left = sinc(g_u) * sinc(g_v) * mean_over_bin(g_u, g_v, bins, triangle)
    return tl.where((tl.abs(g_u) < 1.0) & (tl.abs(g_v) < 1.0), left, 0.0)


@triton.jit
def even_transfer(f):
    """Return what interpolation leaves of even aliases of a frequency along one axis."""
    cosine, _ = wave(0.5 * f)
    return cosine * cosine


@triton.jit
def plane_waves(j, fu, fv, carrier, at_u, at_v, bins, triangle, batch, variant: tl.constexpr):
    """Return what the planes of red, green and blue read of the j-th harmonic in front of the
    optics: cosine and sine of each, a tuple of six.

    Args:
        fu, fv: its frequency, cycles per sensor pixel. carrier: its phase. at_u, at_v: phases of
            the alias 1 along each axis.
    """
    even_u, even_v = even_transfer(fu), even_transfer(fv)
    none = 0.0 * fu
    waves = none, none, none, none, none, none
    start, end = tl.load(batch.alias_start + j), tl.load(batch.alias_start + j + 1)
    for t in range(start, end):
        m_u, m_v = tl.load(batch.alias + 2 * t), tl.load(batch.alias + 2 * t + 1)
        left = alias_transfer(fu, fv, m_u, m_v, bins, triangle)
        cos, sin = wave_at(carrier - m_u.to(tl.uint32) * at_u - m_v.to(tl.uint32) * at_v)
        planes, added = plane_transfers(even_u, even_v, m_u, m_v, variant.bayer), ()
        for plane in tl.static_range(3):
            share = planes[plane] * left
            added = added + (
                waves[2 * plane] + share * cos,
                waves[2 * plane + 1] + share * sin,
            )
        waves = added
    return waves


@triton.jit
def responses(bins, image, batch, variant: tl.constexpr):
    """Return what bins read of a picture of full light in one channel, through a filter that passes
    all of it, by channel and filter: a tuple of nine."""
    sensor, triangle = batch.sensors + image * CAMERA_FIELDS, tl.load(batch.triangle + image)
    at_x, at_y = fraction(bins.x / variant.period_x), fraction(bins.y / variant.period_y)
    # an alias turns by half a cycle from one sensor pixel to the next; the first is in phase
    from_u = (bins.u + 0.5 * batch.width) * tl.load(sensor + SCALE_U) - 0.5
    from_v = (bins.v + 0.5 * batch.height) * tl.load(sensor + SCALE_V) - 0.5
    at_u, at_v = fraction(0.5 * from_u), fraction(0.5 * from_v)
    light = ()
    for channel in tl.static_range(3):
        mean = tl.load(batch.mean + image * 3 + channel) + 0.0 * bins.xu
        light = light + (
            mean,
            mean,
            mean,
        )
    first, last = tl.load(batch.harmonic_start + image), tl.load(batch.harmonic_start + image + 1)
    for j in range(first, last):
        h = tl.load(batch.harmonic + j)
        k, l = tl.load(batch.orders + 2 * h), tl.load(batch.orders + 2 * h + 1)
        per_x, per_y = k.to(tl.float32) / variant.period_x, l.to(tl.float32) / variant.period_y
        fu, fv = per_x * bins.xu + per_y * bins.yu, per_x * bins.xv + per_y * bins.yv
        carrier = k.to(tl.uint32) * at_x + l.to(tl.uint32) * at_y
        waves = plane_waves(j, fu, fv, carrier, at_u, at_v, bins, triangle, batch, variant)
        passed, total = transfer(fu, fv, sensor), ()
        for channel in tl.static_range(3):
            wave_of = batch.coefficients + ((image * 3 + channel) * batch.harmonics + h) * 2
            real, imaginary = passed * tl.load(wave_of), passed * tl.load(wave_of + 1)
            for plane in tl.static_range(3):
                seen = real * waves[2 * plane] - imaginary * waves[2 * plane + 1]
                total = total + (light[3 * channel + plane] + seen,)
        light = total
    return light


@triton.jit
def _add(a, b):
    return a + b


@triton.jit
def pattern_variance(out, batch, variant: tl.constexpr, BLOCK: tl.constexpr):
    """Fill out (B, 3) with the variance of the panel's pattern that bins in the middle average
    away, as a share of the squared mean light, by colour filter: a program an image.

    BLOCK: at least `batch.harmonics`.
    """
    image, h = tl.program_id(0), tl.arange(0, BLOCK)
    valid, none = h < batch.harmonics, 0.0 * h
    middle = none.to(tl.float64)
    bins = bins_at(middle, middle, image, batch, variant)
    k = tl.load(batch.orders + 2 * h, mask=valid, other=0).to(tl.float32) / variant.period_x
    l = tl.load(batch.orders + 2 * h + 1, mask=valid, other=0).to(tl.float32) / variant.period_y
    fu, fv = k * bins.xu + l * bins.yu, k * bins.xv + l * bins.yv
    even_u, even_v = even_transfer(fu), even_transfer(fv)
    first_u, first_v = tl.floor(2.0 * fu).to(tl.int32) - 1, tl.floor(2.0 * fv).to(tl.int32) - 1
    triangle = tl.load(batch.triangle + image)
    left = none, none, none
    for i in range(16):
        m_u, m_v = first_u + i // 4, first_v + i % 4
        of_alias = alias_transfer(fu, fv, m_u, m_v, bins, triangle)
        planes, added = plane_transfers(even_u, even_v, m_u, m_v, variant.bayer), ()
        for plane in tl.static_range(3):
            share = planes[plane] * of_alias
            added = added + (left[plane] + share * share,)
        left = added
    passed = transfer(fu, fv, batch.sensors + image * CAMERA_FIELDS)
    for plane in tl.static_range(3):
        real, imaginary, mean = none, none, 0.0
        for channel in tl.static_range(3):
            share = tl.load(batch.filters + (image * 3 + plane) * 3 + channel)
            wave_of = batch.coefficients + ((image * 3 + channel) * batch.harmonics + h) * 2
            real += share * tl.load(wave_of, mask=valid, other=0.0)
            imaginary += share * tl.load(wave_of + 1, mask=valid, other=0.0)
            mean += share * tl.load(batch.mean + image * 3 + channel)
        lost = 0.5 * passed * passed * tl.maximum(1.0 - left[plane], 0.0)
        power = tl.reduce(lost * (real * real + imaginary * imaginary), 0, _add)
        tl.store(out + image * 3 + plane, power / tl.maximum(mean * mean, 1e-12))
