"""What aperture, lens, low-pass filter and motion leave of a wave, float32; and the waves."""

from __future__ import annotations

import math

import numpy as np
import triton
import triton.language as tl
from numpy.polynomial import Polynomial

from moireaug.camera.exposure import footprint
from moireaug.engine.gpu.arrays import camera_field
from moireaug.engine.gpu.physics import bind_for_triton
from moireaug.engine.gpu.physics import footprint as view
from moireaug.engine.gpu.view import load32

FILL, BLUR, OLPF = camera_field("fill"), camera_field("blur"), camera_field("olpf")
MOTION_X, MOTION_Y = camera_field("motion_x"), camera_field("motion_y")

PI_SQUARED = tl.constexpr(math.pi**2)
MIN_EXPONENT = tl.constexpr(footprint.MIN_EXPONENT)
# sin and cos at t = pi d / 2, d in [-1/2, 1/2], by Taylor's series
S0, S1, S2, S3, S4 = (
    tl.constexpr((math.pi / 2) ** (2 * i + 1) * (-1) ** i / math.factorial(2 * i + 1))
    for i in range(5)
)
C1, C2, C3, C4 = (
    tl.constexpr((math.pi / 2) ** (2 * i) * (-1) ** i / math.factorial(2 * i)) for i in range(1, 5)
)
# sin(pi r), r in [-1/2, 1/2], by its series
R0, R1, R2, R3, R4, R5 = (
    tl.constexpr(math.pi ** (2 * i + 1) * (-1) ** i / math.factorial(2 * i + 1)) for i in range(6)
)
# sin(pi x) / (pi x), x in [-1, 1], as a polynomial in the square of x
_squares = (1 - np.cos(np.pi * (np.arange(64) + 0.5) / 64)) / 2
_fitted = Polynomial.fit(_squares, np.sinc(np.sqrt(_squares)), 6).convert().coef
P0, P1, P2, P3, P4, P5, P6 = (tl.constexpr(float(coefficient)) for coefficient in _fitted)


@triton.jit
def wave(cycles):
    """Return the cosine and the sine of a number of cycles, as accurate as that is."""
    return wave_of_part(cycles - tl.floor(cycles + 0.5))


@triton.jit
def wave_of_part(d):
    """Return the cosine and the sine of a part of a cycle, from -1/2 to 1/2."""
    t = d * d
    # of a quarter of the angle, which is doubled twice
    sine = d * (S0 + t * (S1 + t * (S2 + t * (S3 + t * S4))))
    cosine = 1.0 + t * (C1 + t * (C2 + t * (C3 + t * C4)))
    sine, cosine = 2.0 * sine * cosine, 1.0 - 2.0 * sine * sine
    return 1.0 - 2.0 * sine * sine, 2.0 * sine * cosine


@triton.jit
def sinc(x):
    """Return sin(pi x) / (pi x)."""
    x = tl.abs(x)
    whole = tl.floor(x + 0.5)
    r, odd = x - whole, whole - 2.0 * tl.floor(0.5 * whole)
    t = r * r
    sine = r * (R0 + t * (R1 + t * (R2 + t * (R3 + t * (R4 + t * R5)))))
    # a reciprocal root is one instruction, and a quotient several
    quotient = sine * (1.0 - 2.0 * odd) * tl.rsqrt(tl.maximum(x * x, 1e-12) * PI_SQUARED)
    return tl.where(x < 1e-6, 1.0, quotient)


@triton.jit
def sinc_within(x):
    """Return `sinc` for x from -1 to 1."""
    t = x * x
    return t * (P1 + t * (P2 + t * (P3 + t * (P4 + t * (P5 + t * P6))))) + P0


@triton.jit
def cos_pi(x):
    """Return cos(pi x)."""
    return wave(0.5 * x)[0]


@triton.jit
def bell(exponent):
    """Return the exponential of a number that is not positive."""
    return tl.exp(tl.maximum(exponent, MIN_EXPONENT))


pixel = bind_for_triton("optics", sinc=sinc, cos_pi=cos_pi, exp=bell)


@triton.jit
def transfer(fu, fv, camera):
    """Return the modulation transfer of aperture and lens at a frequency in cycles per sensor pixel
    along u and v."""
    fill, blur, olpf = load32(camera, FILL), load32(camera, BLUR), load32(camera, OLPF)
    motion_x, motion_y = load32(camera, MOTION_X), load32(camera, MOTION_Y)
    return pixel.transfer(fu, fv, (fill, blur, olpf, motion_x, motion_y))


@triton.jit
def blur_variance(by_u, by_v, camera):
    """Return the variance that lens, motion and low-pass filter add along one axis of the panel, in
    squared panel pixels; by_u, by_v: panel pixels along it per sensor pixel along u and v."""
    blur, olpf = load32(camera, BLUR), load32(camera, OLPF)
    moved = view.motion_sigma(by_u, by_v, load32(camera, MOTION_X), load32(camera, MOTION_Y))
    return view.lens_variance(by_u, by_v, blur, olpf) + moved * moved
