"""Pictures as screens show them, drawn: dead leaves, textures, pages, interfaces, charts, gradients
and signs. A picture is a pure function of its generator, and nobody else's work is in it."""

from functools import cache

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from training.data import signs
from training.data.sign_backgrounds import noise

SUPERSAMPLING = 2  # shapes are drawn at this multiple of the final resolution
LETTERS = "etaoinshrdlcumwfgypbvk"
LEAF_SIDES = (3, 4, 4, 5, 6, 16, 16, 16, 16)
SLOPES = (0.5, 0.8, 1.2, 2.0)  # of fractal noise, whose tiles are kept

Colour = tuple[int, ...]


def render(rng: np.random.Generator, side: int) -> tuple[str, Image.Image]:
    """Draw a picture of random content; return the kind of content and the picture, (side, side)
    RGB."""
    kind = str(rng.choice(list(KINDS), p=[weight for _, weight in KINDS.values()]))
    draw, _ = KINDS[kind]
    return kind, draw(rng, side)


def dead_leaves(rng: np.random.Generator, side: int) -> Image.Image:
    """Draw shapes that cover one another, their radii as 1 / r^3 as in photographs (Lee, Mumford
    and Huang, 2001), with texture and light."""
    extent = SUPERSAMPLING * side
    palette = [_colour(rng) for _ in range(rng.integers(3, 9))]
    colours = Image.new("RGB", (extent, extent), palette[0])
    grains = Image.new("L", (extent, extent))
    colour_pen, grain_pen = ImageDraw.Draw(colours), ImageDraw.Draw(grains)
    low, high = rng.uniform(0.004, 0.02) * extent, rng.uniform(0.2, 0.5) * extent
    for _ in range(rng.integers(150, 700)):
        radius = (low**-2 + rng.random() * (high**-2 - low**-2)) ** -0.5
        corners = _leaf(rng, radius, rng.uniform(0, extent, 2))
        base = palette[rng.integers(len(palette))]
        colour_pen.polygon(corners, fill=_near(rng, base))
        grain_pen.polygon(corners, fill=int(rng.integers(256)))
    picture = _codes(colours.reduce(SUPERSAMPLING))
    amount = _codes(grains.reduce(SUPERSAMPLING))[..., None] ** 2
    grain = noise(rng, side, rng.uniform(40, 200), _slope(rng)) - 0.5
    return _image((picture * (1 + 1.2 * amount * grain)) * _light(rng, side))


def texture(rng: np.random.Generator, side: int) -> Image.Image:
    """Draw fractal noise between colours: grass, fur, clouds, wood."""
    flat = float(np.exp(rng.uniform(-1.2, 1.2)))
    mix = noise(rng, side, rng.uniform(40, 150), _slope(rng), flat)
    mix = np.clip((mix - 0.5) * rng.uniform(0.6, 2.5) + 0.5, 0, 1)
    first, second, third = (np.array(_colour(rng)) / 255 for _ in range(3))
    picture = first + (second - first) * mix
    other = noise(rng, side, rng.uniform(20, 100), 2.0)
    return _image((picture + (third - picture) * other**3) * _light(rng, side))


def page(rng: np.random.Generator, side: int) -> Image.Image:
    """Draw lines of text on paper, or on a dark page."""
    paper, ink = _page_colours(rng)
    extent = SUPERSAMPLING * side
    canvas = Image.new("RGB", (extent, extent), paper)
    pen = ImageDraw.Draw(canvas)
    top = rng.uniform(-30, 30)
    while top < extent:
        height = int(rng.uniform(7, 24 if rng.random() < 0.8 else 60) * SUPERSAMPLING)
        lines = int(rng.integers(1, 12))
        _paragraph(pen, rng, (rng.uniform(-40, 0.3 * extent), top), height, lines, ink)
        top += height * (1.3 * lines + rng.uniform(0.2, 2))
    return canvas.reduce(SUPERSAMPLING)


def interface(rng: np.random.Generator, side: int) -> Image.Image:
    """Draw windows with bars, buttons, words and small pictures."""
    extent = SUPERSAMPLING * side
    paper, ink = _page_colours(rng)
    canvas = Image.new("RGB", (extent, extent), paper)
    pen = ImageDraw.Draw(canvas)
    for _ in range(rng.integers(4, 16)):
        left, top = rng.uniform(-0.1, 0.9, 2) * extent
        width, height = np.exp(rng.uniform(np.log(0.08), np.log(0.9), 2)) * extent
        box = (left, top, left + width, top + height)
        part = rng.choice(["panel", "words", "picture", "rule"], p=[0.35, 0.35, 0.2, 0.1])
        if part == "panel":
            fill, outline = _near(rng, paper, 25), _near(rng, ink, 60)
            if rng.random() < 0.4:
                fill = _colour(rng)
            radius = rng.uniform(0, 0.3) * min(width, height)
            pen.rounded_rectangle(box, radius, fill, outline, int(rng.integers(0, 4)))
        elif part == "words":
            size = int(rng.uniform(7, 22) * SUPERSAMPLING)
            _paragraph(pen, rng, (left, top), size, int(rng.integers(1, 6)), ink, width)
        elif part == "picture":
            inner = dead_leaves if rng.random() < 0.5 else texture
            small = max(16, int(min(width, height, 0.5 * extent)))
            canvas.paste(inner(rng, small), (int(left), int(top)))
        else:
            pen.line((left, top, left + width, top), _near(rng, ink, 60), int(rng.integers(1, 4)))
    return canvas.reduce(SUPERSAMPLING)


def chart(rng: np.random.Generator, side: int) -> Image.Image:
    """Draw a grid with curves, bars or sectors."""
    extent = SUPERSAMPLING * side
    paper, ink = _page_colours(rng)
    canvas = Image.new("RGB", (extent, extent), paper)
    pen = ImageDraw.Draw(canvas)
    grid = _near(rng, paper, 60)
    for place in np.arange(0, extent, rng.uniform(0.06, 0.25) * extent):
        pen.line((place, 0, place, extent), grid, SUPERSAMPLING)
        pen.line((0, place, extent, place), grid, SUPERSAMPLING)
    for _ in range(rng.integers(1, 6)):
        colour, kind = _colour(rng), rng.integers(3)
        if kind == 0:
            across = np.linspace(0, extent, int(rng.integers(5, 60)))
            up = extent * (rng.random() + 0.1 * np.cumsum(rng.normal(0, 0.5, len(across))))
            pen.line(list(zip(across, up, strict=True)), colour, int(rng.integers(2, 9)))
        elif kind == 1:
            wide = rng.uniform(0.03, 0.12) * extent
            for left in np.arange(rng.uniform(0, wide), extent, 2.5 * wide):
                pen.rectangle((left, rng.uniform(0.1, 1) * extent, left + wide, extent), colour)
        else:
            (x, y), radius = rng.uniform(0, extent, 2), rng.uniform(0.1, 0.4) * extent
            first = rng.uniform(0, 360)
            box = (x - radius, y - radius, x + radius, y + radius)
            pen.pieslice(box, first, first + rng.uniform(30, 330), colour)
    _paragraph(pen, rng, (0.1 * extent, 0), int(rng.uniform(8, 20) * SUPERSAMPLING), 2, ink)
    return canvas.reduce(SUPERSAMPLING)


def gradient(rng: np.random.Generator, side: int) -> Image.Image:
    """Draw colours that change slowly, as in skies, walls and objects out of focus."""
    knots = rng.random((int(rng.integers(2, 6)), int(rng.integers(2, 6)), 3)) - 0.5
    small = _image(np.array(_colour(rng)) / 255 + rng.uniform(0.05, 0.8) * knots)
    return small.resize((side, side), Image.Resampling.BICUBIC)


def sign(rng: np.random.Generator, side: int) -> Image.Image:
    """Draw a street with a sign."""
    label = int(rng.integers(len(signs.CLASSES)))
    return Image.fromarray(signs.render(label, rng, side))


# what draws each kind, and how often
KINDS = {
    "dead leaves": (dead_leaves, 0.35),
    "texture": (texture, 0.15),
    "page": (page, 0.15),
    "interface": (interface, 0.15),
    "chart": (chart, 0.05),
    "gradient": (gradient, 0.1),
    "sign": (sign, 0.05),
}


def _paragraph(
    pen: ImageDraw.ImageDraw,
    rng: np.random.Generator,
    corner: tuple[float, float],
    height: int,
    lines: int,
    ink: Colour,
    width: float = float("inf"),
) -> None:
    """Write lines of words that nobody reads from a corner, letters of a height in pixels, about
    as wide as asked."""
    font = _font(height)
    letters = min(width / (0.5 * height), int(rng.integers(10, 80)))
    bold = int(rng.random() < 0.2) * max(1, height // 20)
    for line in range(lines):
        text = ""
        while len(text) < letters:
            word = "".join(rng.choice(list(LETTERS), rng.integers(1, 11)))
            text += (word.capitalize() if rng.random() < 0.15 else word) + " "
        place = (corner[0], corner[1] + 1.3 * height * line)
        pen.text(place, text, ink, font, stroke_width=bold, stroke_fill=ink)


@cache
def _font(height: int) -> ImageFont.ImageFont | ImageFont.FreeTypeFont:
    return ImageFont.load_default(size=height)


def _slope(rng: np.random.Generator) -> float:
    return SLOPES[rng.integers(len(SLOPES))]


def _leaf(rng: np.random.Generator, radius: float, middle: np.ndarray) -> list[tuple[float, float]]:
    """Return the corners of a polygon, stretched and turned at random."""
    sides = LEAF_SIDES[rng.integers(len(LEAF_SIDES))]
    angles = 2 * np.pi * (np.arange(sides) / sides + rng.random())
    stretch, turn = np.exp(rng.normal(0, 0.4)), rng.uniform(0, np.pi)
    x, y = radius * stretch * np.cos(angles), radius / stretch * np.sin(angles)
    across = middle[0] + x * np.cos(turn) - y * np.sin(turn)
    down = middle[1] + x * np.sin(turn) + y * np.cos(turn)
    return list(zip(across.tolist(), down.tolist(), strict=True))


def _light(rng: np.random.Generator, side: int) -> np.ndarray:
    """Draw light that changes slowly, (side, side, 1)."""
    return 1 - rng.uniform(0, 0.5) * noise(rng, side, rng.uniform(5, 60), 2.0)


def _colour(rng: np.random.Generator) -> Colour:
    """Draw a colour, mostly dull, of any brightness."""
    grey = rng.uniform(0.05, 1)
    chroma = rng.normal(0, rng.choice([0.03, 0.12, 0.4]), 3)
    return tuple(int(code) for code in np.clip(255 * (grey + chroma), 0, 255))


def _near(rng: np.random.Generator, colour: Colour, distance: float = 15) -> Colour:
    """Draw a colour near another, at a distance in codes."""
    codes = np.array(colour) + rng.normal(0, distance) + rng.normal(0, distance / 3, 3)
    return tuple(int(code) for code in np.clip(codes, 0, 255))


def _page_colours(rng: np.random.Generator) -> tuple[Colour, Colour]:
    """Draw the colours of paper and ink; one page in four is dark."""
    light = _near(rng, (255, 255, 255), 12)
    dark = _near(rng, (20, 20, 20), 20)
    if rng.random() < 0.2:
        light = tuple(int(255 - 0.4 * (255 - code)) for code in _colour(rng))
    return (dark, light) if rng.random() < 0.25 else (light, dark)


def _codes(picture: Image.Image) -> np.ndarray:
    return np.asarray(picture, np.float32) / 255


def _image(picture: np.ndarray) -> Image.Image:
    return Image.fromarray((255 * np.clip(picture, 0, 1)).round().astype(np.uint8))
