"""Message and traffic signs on varied backgrounds: a data set drawn in memory, the same for the
same seed.

Every image has its own generator, seeded by (seed, split, index): any one can be drawn alone, in
any order. Classes are confusable on purpose (30 / 50 / 80, left / right, pictograms, words), and
the background holds sign colours too.
"""

import functools
import math

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFilter
from torch import Tensor
from torch.utils.data import Dataset

from training.config.data_sets import DATA, Data
from training.data.sign_backgrounds import clutter, noise, scene
from training.data.sign_faces import FACES, SIGN_COLOURS, STYLES, Pen, face, polygon
from training.data.splits import Splits

CLASSES: tuple[str, ...] = tuple(FACES)
SPLITS: tuple[str, ...] = ("train", "val", "test")

_SUPERSAMPLING = 2  # supersampling of a picture; the faces are filtered to match beforehand


def _pose(rng: np.random.Generator, side: int) -> tuple[np.ndarray, float]:
    """Draw where the sign hangs: the homography (3, 3) from the face, [-1, 1] along each axis, to
    picture pixels, and the sign's radius in pixels."""
    radius = side * rng.uniform(0.26, 0.52)
    x, y = side * (0.5 + np.clip(rng.normal(0, 0.07, 2), -0.2, 0.2))
    roll, yaw, pitch = np.radians(rng.normal(0, (7, 22, 10)).clip(-48, 48))
    cos, sin = np.cos((roll, yaw, pitch)), np.sin((roll, yaw, pitch))
    about_z = np.array([[cos[0], -sin[0], 0], [sin[0], cos[0], 0], [0, 0, 1]])
    about_y = np.array([[cos[1], 0, sin[1]], [0, 1, 0], [-sin[1], 0, cos[1]]])
    about_x = np.array([[1, 0, 0], [0, cos[2], -sin[2]], [0, sin[2], cos[2]]])
    plane = about_z @ about_y @ about_x
    distance = 4.0  # in radii of the sign: near enough for the perspective to show
    plane[:, 2] = (0, 0, distance)
    projection = np.array([[radius * distance, 0, x], [0, radius * distance, y], [0, 0, 1]])
    return projection @ plane, radius


def _warp(face: Image.Image, pose: np.ndarray, side: int) -> Image.Image:
    onto_face = np.array([[1, 0, 1], [0, 1, 1], [0, 0, 2 / face.width]]) @ np.linalg.inv(pose)
    warp = tuple((onto_face / onto_face[2, 2]).ravel()[:8])
    kind, filter_ = Image.Transform.PERSPECTIVE, Image.Resampling.BILINEAR
    return face.transform((side, side), kind, warp, filter_)


def _wear(rng: np.random.Generator, paint: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Return premultiplied paint (side, side, 3) after years: bleached by the sun, partly grimy."""
    paint = paint + rng.uniform(0, 0.45) * rng.random() * (0.62 * alpha - paint)
    if rng.random() < 0.5:
        return paint
    grime = rng.uniform(0, 0.6) * np.clip(noise(rng, len(paint), 70) * 2 - 0.8, 0, 1)
    return paint + grime * (np.array((0.24, 0.2, 0.15), np.float32) * alpha - paint)


def _cover(pen: Pen, rng: np.random.Generator, middle: np.ndarray, radius: float) -> None:
    """Draw covers of parts of the sign: a sticker, a scribble, a twig with leaves from beyond the
    rim."""
    if rng.random() < 0.2:
        x, y = middle + rng.uniform(-0.6, 0.6, 2) * radius
        corners = int(rng.choice((4, 20)))
        sticker = polygon(corners, radius * rng.uniform(0.1, 0.25), rng.uniform(0, 90), x, y)
        pen.polygon(sticker, fill=tuple(SIGN_COLOURS[rng.integers(len(SIGN_COLOURS))]))
    if rng.random() < 0.1:
        scribble = middle + rng.uniform(-0.7, 0.7, (6, 2)) * radius
        ink = tuple(rng.integers(0, 200, 3))
        pen.line([tuple(p) for p in scribble], fill=ink, width=2, joint="curve")
    if rng.random() < 0.3:
        angle = rng.uniform(0, 2 * math.pi)
        rim = middle + 1.3 * radius * np.array((math.cos(angle), math.sin(angle)))
        tip = middle + rng.uniform(-0.6, 0.6, 2) * radius
        twig = rim + np.linspace(0, 1, 5)[:, None] * (tip - rim)
        twig += rng.normal(0, 0.05, twig.shape) * radius
        pen.line([tuple(p) for p in twig], fill=(62, 48, 34), width=2)
        for x, y in np.repeat(twig, 3, 0) + rng.normal(0, 0.12, (15, 2)) * radius:
            green = rng.uniform(0.5, 1.2)
            leaf = polygon(4, radius * rng.uniform(0.06, 0.13), rng.uniform(0, 90), x, y)
            pen.polygon(leaf, fill=(int(70 * green), int(110 * green), int(40 * green)))


def _light(rng: np.random.Generator, side: int) -> np.ndarray:
    """Draw the illumination (side, side, 3): exposure, a gradient across the picture, a colour cast
    and shadows."""
    ramp = np.linspace(-1, 1, side, dtype=np.float32)
    slope = rng.normal(0, 0.22, 2).astype(np.float32)
    light = 1 + (slope[0] * ramp[:, None] + slope[1] * ramp).clip(-0.6, 0.6)[..., None]
    if rng.random() < 0.4:
        shade = noise(rng, side, rng.uniform(30, 90), 2.0) * rng.uniform(4, 20) - rng.uniform(1, 8)
        light = light * (1 - rng.uniform(0.3, 0.65) * np.clip(shade, 0, 1))
    return light * (math.exp(rng.normal(-0.1, 0.25)) * rng.normal(1, 0.05, 3)).astype(np.float32)


def _photograph(rng: np.random.Generator, picture: np.ndarray) -> np.ndarray:
    """Add haze, blur, sensor noise and rounding: float (side, side, 3) to uint8 of that shape."""
    if rng.random() < 0.2:
        picture = picture + rng.uniform(0.1, 0.5) * (rng.uniform(0.5, 0.85) - picture)
    image = Image.fromarray(_uint8(picture))
    if rng.random() < 0.6:
        # Unequal radii: part defocus, part motion.
        blur = rng.uniform(0.2, 0.9) + rng.uniform(0, 0.6, 2) * rng.random() ** 2
        image = image.filter(ImageFilter.GaussianBlur(tuple(blur * len(picture) / 48)))
    picture = np.asarray(image).astype(np.float32) / 255
    grain = rng.standard_normal(picture.shape, np.float32) * (0.3 + picture)
    return _uint8(picture + rng.uniform(0.005, 0.08) * grain)


def _uint8(picture: np.ndarray) -> np.ndarray:
    return (picture.clip(0, 1) * 255 + 0.5).astype(np.uint8)


def render(label: int, rng: np.random.Generator, size: int) -> np.ndarray:
    """Draw one photograph, uint8 (size, size, 3), sRGB, of the sign CLASSES[label]; all randomness
    comes from rng.

    Raises:
        ValueError: a size below 16.
    """
    _check_size(size)
    fine = _SUPERSAMPLING * size
    street = Image.fromarray(_uint8(scene(rng, size)))
    canvas = street.resize((fine, fine), Image.Resampling.NEAREST)
    pen = ImageDraw.Draw(canvas)
    clutter(pen, rng, fine)
    pose, radius = _pose(rng, fine)
    middle = pose[:2, 2] / pose[2, 2]
    if rng.random() < 0.6:
        grey, half = int(rng.integers(60, 180)), rng.uniform(0.03, 0.08) * radius
        post = (middle[0] - half, middle[1], middle[0] + half, fine)
        pen.rectangle(post, fill=(grey, grey, grey))
    name, style = CLASSES[label], int(rng.integers(STYLES))
    shines = name.startswith(("board", "lane")) or (name.startswith("speed") and style == 2)
    sign = _warp(face(name, style, 128 if radius > 36 else 64), pose, fine)
    if not shines:
        sign = sign.convert("RGBA")
        _cover(ImageDraw.Draw(sign), rng, middle, radius)
        sign = sign.convert("RGBa")
    layer = np.asarray(sign.reduce(_SUPERSAMPLING)) / np.float32(255)
    paint, alpha = layer[..., :3] * rng.uniform(0.85, 1.05, 3).astype(np.float32), layer[..., 3:]
    light = _light(rng, size)
    picture = np.asarray(canvas.reduce(_SUPERSAMPLING)) / np.float32(255) * (1 - alpha)
    if shines:
        # It emits its own light, which neither shade nor exposure dims and which spills over.
        blurred = Image.fromarray(_uint8(paint)).filter(ImageFilter.GaussianBlur(0.04 * size))
        glow = np.asarray(blurred) * np.float32(rng.uniform(0.1, 0.6) / 255)
        picture = picture * light + paint + glow
    else:
        picture = (picture + _wear(rng, paint, alpha)) * light
    return _photograph(rng, picture)


def label_of(split: str, index: int, seed: int = 0) -> int:
    """Return the class of one image: every run of len(CLASSES) indices holds each class once, in an
    order of its own."""
    block, place = divmod(index, len(CLASSES))
    return int(_generator(split, block, seed, stream=1).permutation(len(CLASSES))[place])


def make(split: str, n: int, size: int = 48, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Draw the first n images of a split, uint8 (n, 3, size, size), and their classes, int64 (n,).

    Args:
        split: "train", "val" or "test"; they share no randomness.
        n: number of images; a longer set begins with the shorter one, and classes are balanced to
            within one image.
        size: side in pixels, at least 16.
        seed: not negative; another seed is another data set.

    Raises:
        ValueError: a size below 16.
    """
    _check_size(size)
    labels = [label_of(split, index, seed) for index in range(n)]
    images = np.empty((n, size, size, 3), np.uint8)
    for index, label in enumerate(labels):
        images[index] = render(label, _generator(split, index, seed, stream=0), size)
    pictures = torch.from_numpy(images).permute(0, 3, 1, 2).contiguous()
    return pictures, torch.tensor(labels, dtype=torch.int64, device="cpu")


def _generator(split: str, index: int, seed: int, stream: int) -> np.random.Generator:
    return np.random.default_rng((seed, SPLITS.index(split), index, stream))


def _check_size(size: int) -> None:
    if size < 16:
        raise ValueError(
            f"size={size} is too small to tell the signs apart: pass at least 16 pixels."
        )


class Signs(Dataset):
    """One split of the signs, all of it drawn once the first image is read: an attack on trained
    weights needs no training images.

    Args: as in `make`.
    """

    def __init__(self, split: str, n: int, size: int, seed: int) -> None:
        self.split, self.n, self.size, self.seed = split, n, size, seed

    def __len__(self) -> int:
        return self.n

    def __getitem__(self, index: int) -> tuple[Tensor, Tensor]:
        images, labels = self._images_and_labels
        return images[index], labels[index]

    @functools.cached_property
    def _images_and_labels(self) -> tuple[Tensor, Tensor]:
        return make(self.split, self.n, self.size, self.seed)


def read(cfg: Data) -> Splits:
    """Return the signs in the numbers that are asked for."""
    parts = []
    for part in SPLITS:
        n = getattr(cfg, part)
        if n is None:
            n = getattr(DATA[cfg.name], part)
        parts.append(Signs(part, n, cfg.size, cfg.seed))
    train, val, test = parts
    return Splits(train, val, test, dict(enumerate(CLASSES)), len(CLASSES))
