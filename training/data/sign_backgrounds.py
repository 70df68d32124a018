"""Backgrounds of the signs: streets, and clutter in the colours of signs.

Pictures are float32 (side, side, 3) arrays, 0 to 1, at the final resolution; shapes are drawn at
twice that.
"""

from functools import cache

import numpy as np
from PIL import Image

from training.data.sign_faces import SIGN_COLOURS, Pen, polygon


@cache
def noise_tile(slope: float) -> Image.Image:
    """Return fractal noise with amplitude 1 / frequency^slope, 512 x 512, with all values in [0, 1]
    equally frequent."""
    frequency = np.hypot(np.fft.fftfreq(512)[:, None], np.fft.rfftfreq(512))
    frequency[0, 0] = 1.0
    white = np.fft.rfft2(np.random.default_rng(7).standard_normal((512, 512)))
    pixels = np.fft.irfft2(white / frequency**slope).ravel()
    rank = pixels.argsort(kind="stable").argsort(kind="stable")
    return Image.fromarray((rank.reshape(512, 512) / 512**2).astype(np.float32))


def noise(
    rng: np.random.Generator, side: int, extent: float, slope: float = 1.5, flat: float = 1.0
) -> np.ndarray:
    """Cut a random window (side, side, 1) of the noise tile, extent tile pixels wide and flat times
    as high."""
    x, y = rng.uniform(0, 512 - extent), rng.uniform(0, 512 - extent * flat)
    box = (x, y, x + extent, y + extent * flat)
    window = noise_tile(slope).resize((side, side), Image.Resampling.BILINEAR, box)
    return np.asarray(window)[..., None]


def _colour(
    rng: np.random.Generator, low: tuple[float, ...], high: tuple[float, ...]
) -> np.ndarray:
    """Draw a colour between two, (3,), with a little noise in every channel."""
    colour = np.array(low) + rng.random() * np.subtract(high, low) + rng.normal(0, 0.03, 3)
    return colour.astype(np.float32)


def _sky(rng: np.random.Generator, side: int) -> np.ndarray:
    fall = np.linspace(0, 1, side, dtype=np.float32)[:, None, None]
    zenith = _colour(rng, (0.2, 0.42, 0.75), (0.62, 0.66, 0.72))
    horizon = _colour(rng, (0.7,) * 3, (0.95,) * 3)
    sky = zenith + (horizon - zenith) * fall
    clouds = np.clip(noise(rng, side, rng.uniform(50, 120), 2.0) * 3 - rng.uniform(1, 3), 0, 1)
    return sky + (_colour(rng, (0.75,) * 3, (0.98,) * 3) - sky) * clouds


def _foliage(rng: np.random.Generator, side: int) -> np.ndarray:
    leaves = noise(rng, side, rng.uniform(50, 110), 1.0) * 0.6
    leaves = leaves + noise(rng, side, rng.uniform(20, 60), 1.5) * 0.4
    shade = _colour(rng, (0.03, 0.06, 0.02), (0.16, 0.14, 0.06))
    light = _colour(rng, (0.30, 0.50, 0.14), (0.72, 0.60, 0.26))
    return shade + (light - shade) * np.clip(1.6 * leaves - 0.3, 0, 1)


def _road(rng: np.random.Generator, side: int) -> np.ndarray:
    grain = noise(rng, side, rng.uniform(60, 140), 0.5, 0.4) + noise(rng, side, 80, 1.5, 0.5)
    road = _colour(rng, (0.22,) * 3, (0.52, 0.5, 0.47)) * (0.6 + 0.4 * grain)
    down = np.linspace(0, 1, side, dtype=np.float32)[:, None]
    across = np.linspace(-1, 1, side, dtype=np.float32)
    off_middle = np.abs(across - rng.uniform(-0.8, 0.8) - rng.uniform(-1, 1) * down)
    off_lane = off_middle - 0.02 - 0.08 * down
    return road + (0.6 - 0.7 * road) * np.clip(0.5 - off_lane * side / 2, 0, 1)[..., None]


def _part(x: np.ndarray) -> np.ndarray:
    return x - np.floor(x)


def _facade(rng: np.random.Generator, side: int) -> np.ndarray:
    wall = _colour(rng, (0.48, 0.26, 0.18), (0.84, 0.78, 0.68))
    y, x = np.mgrid[:side, :side].astype(np.float32)
    right = x + rng.uniform(0, 60) + rng.uniform(-0.2, 0.2) * y
    x, y = right, y + rng.uniform(0, 60) + rng.uniform(-0.2, 0.2) * x
    row, brick = rng.uniform(3, 6), rng.uniform(7, 15)
    wide, high = (float(length) for length in rng.uniform(16, 40, 2))
    course = y / row
    joint = (_part(course) < 0.9 / row) | (_part(x / brick + np.floor(course) / 2) < 0.9 / brick)
    across, up = _part(x / wide), _part(y / high)
    pane = (across < 0.55) & (up < 0.65)
    frame = (across < 0.62) & (up < 0.7)
    shine = _colour(rng, (0.08, 0.1, 0.14), (0.5, 0.6, 0.7)) * (0.4 + noise(rng, side, 60))
    picture = wall * (0.8 + 0.3 * noise(rng, side, 100, 0.5))
    picture[joint] = wall * 0.75 + 0.1
    picture[frame] = wall * 0.4 + 0.5
    picture[pane] = shine[pane]
    return picture


def _night(rng: np.random.Generator, side: int) -> np.ndarray:
    return _colour(rng, (0.02, 0.03, 0.05), (0.14, 0.14, 0.2)) * (0.5 + noise(rng, side, 90))


_SCENES = (_sky, _foliage, _road, _facade)


def scene(rng: np.random.Generator, side: int) -> np.ndarray:
    """Draw a street without its sign: night, or one surface, often above another."""
    if rng.random() < 0.15:
        return _night(rng, side)
    upper, lower = rng.integers(len(_SCENES), size=2)
    picture = _SCENES[upper](rng, side)
    if rng.random() < 0.4:
        horizon = int(rng.uniform(0.3, 1) * side)
        picture[horizon:] = _SCENES[lower](rng, side)[horizon:]
    return picture


def clutter(pen: Pen, rng: np.random.Generator, side: int) -> None:
    """Draw plates, posters and lamps in the colours of signs, so that a colour alone says little
    about the class."""
    for _ in range(rng.integers(0, 5)):
        # Farther off than the sign, so duller.
        dull, grey = rng.uniform(0.3, 0.9), rng.uniform(40, 160)
        bright = np.array(SIGN_COLOURS)[rng.integers(len(SIGN_COLOURS), size=3)]
        colours = bright * dull + grey * (1 - dull)
        x, y = rng.uniform(-0.1, 1.1, 2) * side
        radius, turn = rng.uniform(0.05, 0.3) * side, rng.uniform(-30, 30)
        sides = int(rng.choice((3, 4, 4, 8, 24)))
        for shrink, colour in zip((1, 0.8, 0.35), colours[: rng.integers(1, 4)], strict=False):
            corners = polygon(sides, radius * shrink, turn, x, y)
            pen.polygon(corners, fill=tuple(int(c) for c in colour))
