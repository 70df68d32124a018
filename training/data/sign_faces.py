"""The signs' faces: each class is a short drawing, in one of three looks."""

import math
from collections.abc import Callable
from functools import cache

import numpy as np
from PIL import Image, ImageDraw, ImageFont

Colour = tuple[int, int, int]
Box = list[tuple[float, float]]
Pen = ImageDraw.ImageDraw

_FACE = 512  # side of the transparent canvas on which a sign face is drawn, once
STYLES = 3  # looks per class: colours, weight of the lettering, painted or lit
_WHITE, _BLACK, _YELLOW = (244, 244, 240), (18, 18, 20), (250, 196, 20)
_REDS = ((196, 20, 32), (214, 36, 28), (170, 16, 36))
_BLUES = ((16, 82, 170), (24, 104, 196), (10, 60, 140))
_LIGHTS = ((255, 168, 24), (250, 250, 236), (255, 84, 40))
SIGN_COLOURS = (*_REDS, *_BLUES, _YELLOW, _WHITE, _BLACK, (20, 130, 70), _LIGHTS[0])
# Dot-matrix letters, five columns by seven rows; each number is a row, its highest bit at the left.
_LETTERS = {
    "E": (31, 16, 16, 30, 16, 16, 31),
    "X": (17, 17, 10, 4, 10, 17, 17),
    "I": (14, 4, 4, 4, 4, 4, 14),
    "T": (31, 4, 4, 4, 4, 4, 4),
    "S": (15, 16, 16, 14, 1, 1, 30),
    "L": (16, 16, 16, 16, 16, 16, 31),
    "O": (14, 17, 17, 17, 17, 17, 14),
    "W": (17, 17, 17, 21, 21, 27, 17),
}


def _disc(pen: Pen, radius: float, fill: Colour, x: float = 256, y: float = 256) -> None:
    pen.ellipse((x - radius, y - radius, x + radius, y + radius), fill=fill)


def polygon(sides: int, radius: float, turn: float, x: float = 256, y: float = 256) -> Box:
    """Return the corners of a regular polygon; the first is `turn` degrees clockwise of the top."""
    angles = np.radians(turn - 90 + 360 / sides * np.arange(sides))
    return [(x + radius * math.cos(a), y + radius * math.sin(a)) for a in angles]


def _arrow(pen: Pen, points: Box, width: int, head: float, fill: Colour | int) -> None:
    """Draw a bent line with round joints and a triangular head beyond its last point."""
    pen.line(points, fill=fill, width=width, joint="curve")
    (x0, y0), (x, y) = points[-2:]
    pen.polygon(polygon(3, head, 90 + math.degrees(math.atan2(y - y0, x - x0)), x, y), fill=fill)


def _text(pen: Pen, text: str, height: int, fill: Colour, weight: int) -> None:
    font = ImageFont.load_default(size=height)
    pen.text((256, 256), text, fill, font, "mm", stroke_width=weight, stroke_fill=fill)


def _stop(pen: Pen, style: int) -> None:
    pen.polygon(polygon(8, 254, 22.5), fill=_WHITE)
    pen.polygon(polygon(8, 236, 22.5), fill=_REDS[style])
    _text(pen, "STOP", 150 + 8 * style, _WHITE, 5 + style)


def _yield(pen: Pen, style: int) -> None:
    pen.polygon(polygon(3, 270, 180, y=200), fill=_REDS[style])
    pen.polygon(polygon(3, 150 + 12 * style, 180, y=200), fill=_YELLOW if style == 2 else _WHITE)


def _no_entry(pen: Pen, style: int) -> None:
    _disc(pen, 252, _WHITE)
    _disc(pen, 240, _REDS[style])
    pen.rectangle((76 + 6 * style, 212, 436 - 6 * style, 300), fill=_WHITE)


def _priority_road(pen: Pen, style: int) -> None:
    pen.polygon(polygon(4, 254, 0), fill=_BLACK if style == 1 else _WHITE)
    pen.polygon(polygon(4, 242, 0), fill=_WHITE)
    pen.polygon(polygon(4, 170 + 10 * style, 0), fill=_YELLOW)


def _speed(pen: Pen, style: int, text: str) -> None:
    _disc(pen, 252, _BLACK if style == 2 else _WHITE)
    _disc(pen, 246, _REDS[style])
    _disc(pen, 190 + 4 * style, _BLACK if style == 2 else _WHITE)
    _text(pen, text, 280, _LIGHTS[1] if style == 2 else _BLACK, 5 + 3 * style)


def _turn(pen: Pen, style: int, side: int) -> None:
    _disc(pen, 252, _WHITE)
    _disc(pen, 240, _BLUES[style])
    bend = [(256 - 130, 256), (256 + 60, 256)]
    if style:
        bend = [(256 - 70, 400), (256 - 70, 246), (256 + 60, 246)]
    _arrow(pen, [(256 + side * (x - 256), y) for x, y in bend], 62, 110, _WHITE)


def _roundabout(pen: Pen, style: int) -> None:
    _disc(pen, 252, _WHITE)
    _disc(pen, 240, _BLUES[style])
    for start in (30, 150, 270):
        angles = np.radians(start + np.linspace(0, 62, 9))
        arc = [(256 + 130 * math.cos(a), 256 + 130 * math.sin(a)) for a in angles]
        _arrow(pen, arc, 46, 66, _WHITE)


def _warning(pen: Pen, style: int) -> tuple[float, float]:
    """Draw the blank warning sign, a triangle or a diamond; returns the height of its middle and
    the pictogram's scale."""
    if style == 2:
        pen.polygon(polygon(4, 254, 0), fill=_BLACK)
        pen.polygon(polygon(4, 240, 0), fill=_YELLOW)
        return 256, 1.4
    pen.polygon(polygon(3, 290, 0, y=316), fill=_REDS[style])
    pen.polygon(polygon(3, 200, 0, y=316), fill=_YELLOW if style == 1 else _WHITE)
    return 326, 1.05


def _warning_curve(pen: Pen, style: int) -> None:
    y, k = _warning(pen, style)
    bend = ((-30, 84), (-30, 10), (20, -36), (20, -62))
    _arrow(pen, [(256 + k * dx, y + k * dy) for dx, dy in bend], round(40 * k), 56 * k, _BLACK)


def _warning_crossing(pen: Pen, style: int) -> None:
    y, k = _warning(pen, style)
    _disc(pen, 25 * k, _BLACK, 256 + 4 * k, y - 90 * k)
    legs_and_trunk = ((2, -60, -4, 10), (-4, 0, -44, 84), (-4, 0, 44, 84))
    arms = ((-50, -4, -2, -48), (-2, -48, 54, -6))
    for limbs, width in ((legs_and_trunk, 34), (arms, 22)):
        for x0, y0, x1, y1 in limbs:
            limb = (256 + k * x0, y + k * y0, 256 + k * x1, y + k * y1)
            pen.line(limb, fill=_BLACK, width=round(width * k))


def _lamps(pen: Pen, dots: np.ndarray, colour: Colour) -> None:
    """Draw a board of round lamps, lit where dots (rows, columns) is True, as wide as the canvas
    and centred on it."""
    rows, columns = dots.shape
    pitch = 488 / max(rows, columns)
    left, top = 256 - pitch * columns / 2, 256 - pitch * rows / 2
    pen.rectangle((left - 12, top - 12, 524 - left, 524 - top), fill=(70, 72, 74))
    pen.rectangle((left - 4, top - 4, 516 - left, 516 - top), fill=(16, 16, 18))
    for row, column in np.argwhere(dots):
        _disc(pen, 0.47 * pitch, colour, left + pitch * (column + 0.5), top + pitch * (row + 0.5))


def _word(pen: Pen, style: int, text: str) -> None:
    rows = []
    for row in range(7):
        # Bit -1 shifts by five and so reads a zero: the gap before each letter.
        rows.append(
            [_LETTERS[letter][row] >> (4 - bit) & 1 for letter in text for bit in range(-1, 5)]
        )
    _lamps(pen, np.pad(np.array(rows, bool), ((2 + style, 2 + style), (0, 1))), _LIGHTS[style])


def _lane(pen: Pen, style: int, opened: bool) -> None:
    mask = Image.new("1", (17, 17))
    if opened:
        _arrow(ImageDraw.Draw(mask), [(8, 1), (8, 10)], 3, 6, 1)
    else:
        for line in ((3, 3, 13, 13), (13, 3, 3, 13)):
            ImageDraw.Draw(mask).line(line, fill=1, width=2 + (style > 0))
    colour = ((60, 235, 120), _LIGHTS[1], _LIGHTS[0])[style] if opened else _LIGHTS[2 - style]
    _lamps(pen, np.asarray(mask), colour)


FACES: dict[str, Callable[[Pen, int], None]] = {
    "stop": _stop,
    "yield": _yield,
    "no_entry": _no_entry,
    "priority_road": _priority_road,
    "speed_30": lambda pen, style: _speed(pen, style, "30"),
    "speed_50": lambda pen, style: _speed(pen, style, "50"),
    "speed_80": lambda pen, style: _speed(pen, style, "80"),
    "turn_left": lambda pen, style: _turn(pen, style, -1),
    "turn_right": lambda pen, style: _turn(pen, style, 1),
    "roundabout": _roundabout,
    "warning_curve": _warning_curve,
    "warning_crossing": _warning_crossing,
    "board_exit": lambda pen, style: _word(pen, style, "EXIT"),
    "board_slow": lambda pen, style: _word(pen, style, "SLOW"),
    "lane_open": lambda pen, style: _lane(pen, style, True),
    "lane_closed": lambda pen, style: _lane(pen, style, False),
}


@cache
def face(name: str, style: int, side: int) -> Image.Image:
    """Draw the sign alone, (side, side), premultiplied by its alpha so that it can be resampled
    without dark fringes."""
    canvas = Image.new("RGBA", (_FACE, _FACE))
    FACES[name](ImageDraw.Draw(canvas), style)
    return canvas.convert("RGBa").reduce(_FACE // side)
