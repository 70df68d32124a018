"""Full readings, one for each pixel of the sensor, and the gradient in the picture.

A program computes some pixels of one plane of one image. How pixels see a subpixel of the panel's
cell is what exposure methods differ in: a device function `see`, which returns the subpixel's light
on a white picture, and which pixels shown that light comes from, with what weights.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
import triton
import triton.language as tl
from torch import Tensor

from moireaug.engine.gpu import display
from moireaug.engine.gpu.arrays import upload
from moireaug.engine.gpu.noise import quantiles
from moireaug.engine.gpu.panel import channel_start, content, scatter, screen_of
from moireaug.engine.gpu.sensor_pixels import (
    Reading,
    light_passed,
    look_at_panel,
    place_of,
    pulse_at,
    read,
    reading_of,
)
from moireaug.engine.lower.exposure_records import Exposure

BLOCK_PIXELS = 128  # of a plane, that one program computes
INTERPRETED_BLOCK_PIXELS = 1024  # where each operation of a program costs the same


class Method(NamedTuple):
    """An exposure method.

    Args:
        see: device function, see `expose_full.see`.
        subpixels: a NamedTuple of arrays and sizes, which `see` takes; `colour`, (length,) int32,
            and `length` among them.
        columns, rows: of pixels shown that one sensor pixel sees of a subpixel.
    """

    see: Any
    subpixels: Any
    columns: int
    rows: int


def expose(picture: Tensor, exposure: Exposure, method: Method) -> Tensor:
    """Return the readings (B, planes, h, w) float32 of pictures (B, 3, H, W), float32 or uint8."""
    device = picture.device
    reading, subpixels, numbers = _uploaded(device, exposure, method)
    shape = len(picture), reading.planes, reading.height, reading.width
    raw = torch.empty(shape, dtype=torch.float32, device=device)
    if raw.numel():
        screen = screen_of(display.show(picture, exposure, numbers), exposure.size)
        grid, constants = _launch(raw, exposure, method)
        _expose[grid](raw, screen, subpixels, reading, quantiles(device), **constants)
    return raw


def expose_back(grad: Tensor, picture: Tensor, exposure: Exposure, method: Method) -> Tensor:
    """Return the gradient in pictures (B, 3, H, W) float32, from that in their readings."""
    if not grad.numel():
        return torch.zeros_like(picture)
    reading, subpixels, numbers = _uploaded(picture.device, exposure, method)
    shown = display.show(picture, exposure, numbers)
    screen, light_grad = screen_of(shown, exposure.size), torch.zeros_like(shown.light)
    grid, constants = _launch(grad, exposure, method)
    _expose_back[grid](
        light_grad, grad.contiguous(), screen, subpixels, reading, quantiles(picture.device),
        **constants,
    )  # fmt: skip
    return display.show_back(light_grad, picture, exposure, numbers)


def _uploaded(
    device: torch.device, e: Exposure, method: Method
) -> tuple[Reading, Any, dict[str, Tensor]]:
    """Return the Reading of an exposure, its subpixels, and the numbers that `display.show` takes,
    on a device, by one transfer."""
    reading, subpixels, numbers = reading_of(e), method.subpixels, display.numbers_of(e)
    there = upload(numbers | _arrays_of(reading) | _arrays_of(subpixels), device)
    return _with_tensors(reading, there), _with_tensors(subpixels, there), there


def _arrays_of(record: Any) -> dict[str, np.ndarray]:
    """Return the fields of a NamedTuple that are arrays."""
    fields = record._asdict().items()
    return {name: value for name, value in fields if isinstance(value, np.ndarray)}


def _with_tensors(record: Any, tensors: dict[str, Tensor]) -> Any:
    """Return a NamedTuple with tensors in the place of its arrays."""
    return record._replace(**{name: tensors[name] for name in _arrays_of(record)})


def _launch(
    raw: Tensor, e: Exposure, method: Method
) -> tuple[tuple[int, int, int], dict[str, Any]]:
    """Return the grid of programs, blocks of a plane's pixels, planes and images, and what kernels
    are compiled for."""
    images, planes, height, width = raw.shape
    block = BLOCK_PIXELS if raw.device.type != "cpu" else INTERPRETED_BLOCK_PIXELS
    constants = {
        "SEE": method.see,
        "COLUMNS": method.columns,
        "ROWS": method.rows,
        "TAPS": 2 * e.cell.radius + 1,
        "DARK": e.dark,
        "FLICKERS": e.flicker.shape[1] > 0,
        "NOISY": e.noisy,
        "CLIPS": e.clips,
        "BLOCK": block,
    }
    return (triton.cdiv(height * width, block), planes, images), constants


@triton.jit
def _expose(
    raw, screen, subpixels, reading, quantiles, SEE: tl.constexpr,
    COLUMNS: tl.constexpr, ROWS: tl.constexpr, TAPS: tl.constexpr, DARK: tl.constexpr,
    FLICKERS: tl.constexpr, NOISY: tl.constexpr, CLIPS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Fill raw (B, planes, h, w), a program for BLOCK pixels of a plane."""
    plane, image = tl.program_id(1), tl.program_id(2)
    pixel, count = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK), reading.height * reading.width
    inside, pixel = pixel < count, tl.minimum(pixel, count - 1)
    u, v, row = place_of(pixel, plane, reading)
    sight = look_at_panel(u, v, image, reading)
    light = 0.0 * u.to(tl.float32)
    for i in range(subpixels.length):
        colour, passed = light_passed(i, plane, image, subpixels, reading)
        if passed != 0.0:
            white, left, top, across, down = SEE(
                i, sight, image, reading, screen, subpixels, COLUMNS, ROWS, TAPS, DARK
            )
            pixels, white = screen.light + channel_start(image, colour, screen), passed * white
            light += white * content(pixels, left, top, across, down, screen, COLUMNS, ROWS)
    light *= pulse_at(row, image, reading, FLICKERS)
    value, _ = read(light, u, v, pixel, plane, image, reading, quantiles, NOISY, CLIPS)
    raw += (image.to(tl.int64) * reading.planes + plane) * count
    tl.store(raw + pixel, value, mask=inside)


@triton.jit
def _expose_back(
    light_grad, grad, screen, subpixels, reading, quantiles, SEE: tl.constexpr,
    COLUMNS: tl.constexpr, ROWS: tl.constexpr, TAPS: tl.constexpr, DARK: tl.constexpr,
    FLICKERS: tl.constexpr, NOISY: tl.constexpr, CLIPS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Add to light_grad, the gradient in `screen.light`, what comes from that in raw."""
    plane, image = tl.program_id(1), tl.program_id(2)
    pixel, count = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK), reading.height * reading.width
    inside, pixel = pixel < count, tl.minimum(pixel, count - 1)
    u, v, row = place_of(pixel, plane, reading)
    sight = look_at_panel(u, v, image, reading)
    grad += (image.to(tl.int64) * reading.planes + plane) * count
    back, pulse = tl.load(grad + pixel), pulse_at(row, image, reading, FLICKERS)
    light, slope = 0.0 * back, 0.0 * back
    # twice over the subpixels: for their light, on which the slope may depend, and for the gradient
    for turn in range(0 if NOISY or CLIPS else 1, 2):
        if turn == 1:
            _, slope = read(
                light * pulse, u, v, pixel, plane, image, reading, quantiles, NOISY, CLIPS
            )
        for i in range(subpixels.length):
            colour, passed = light_passed(i, plane, image, subpixels, reading)
            if passed != 0.0:
                white, left, top, across, down = SEE(
                    i, sight, image, reading, screen, subpixels, COLUMNS, ROWS, TAPS, DARK
                )
                start, white = channel_start(image, colour, screen), passed * white
                if turn == 0:
                    pixels = screen.light + start
                    light += white * content(pixels, left, top, across, down, screen, COLUMNS, ROWS)
                else:
                    scatter(
                        light_grad + start, back * slope * pulse * white, left, top, across, down,
                        inside, screen, COLUMNS, ROWS,
                    )  # fmt: skip
