"""Examples for a detector of screen photos: crops at a photo's own pixels, and whole photos made
small; screens from any camera, and what is none."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from PIL import Image
from torch import Tensor
from torch.utils.data import Dataset

from moireaug.camera.effects.srgb import codes_of_light, light_of_codes
from moireaug.capture import capture
from moireaug.mixtures import Mixture, as_scenes, sample_one, scenes_of
from moireaug.scene.by_name import with_values
from moireaug.scenes import Scene
from moireaug.synthesis import Room, RoomPhotos, screen_in_room, without_moire
from moireaug.synthesis.pictures import Source
from moireaug.synthesis.twins import moire_codes
from training.data import drawn_pictures
from training.data.codes import codes_of, picture_of, rounded, through_jpeg
from training.detection.network import CROP_SIDE, WHOLE_SIDE, shrunk

CUT_SIDES = (256, 352)  # of crops before they are shrunk, as photos are when they are shared
PHOTO_SIDE = 512  # longer side of a simulated whole photo, pixels
DRAWN = 0.3  # share of the shown pictures that are interfaces and pages
MIN_SHARE = 0.4  # of a crop, that a screen takes
MIN_MOIRE = 1.0  # codes of moiré, below which a photo and its twin look alike
CROP_SHRINK, WHOLE_SHRINK = (1.0, 4.0), (3.0, 8.0)  # of photos as they are shared, and made small
ASPECTS = (16 / 9, 16 / 9, 16 / 10, 3 / 2, 4 / 3, 9 / 16, 9 / 19)  # of screens, width over height
NEAR = Room(extent=(0.9, 4.0), bezel=(0.01, 0.15))  # a part of a screen, and often its edge
WHOLE = Room(extent=(0.35, 1.3))
AMBIENT = (0.25, 1.0)  # light of rooms without a screen, for which cameras expose
REFLECTED = (0.4, 0.9)  # of the room's light, by the paper of prints


class Example(NamedTuple):
    """What the network sees, and whether it is a screen.

    image: (3, side, side) uint8. look: "crop" or "whole". kind: what it is, in words.
    """

    image: Tensor
    look: str
    is_screen: bool
    kind: str


class Examples(Dataset):
    """Examples by number, each a pure function of (seed, number) and the pictures.

    Args:
        pictures: those that screens show and that rooms are.
        scenes: of the screens, which state `Sensor.pitch` or `Panel.width`; those of LEDs stand in
            no room.
    """

    def __init__(self, pictures: Source, scenes: Scene | Mixture, seed: int) -> None:
        self.pictures, self.seed = pictures, seed
        every = scenes_of(scenes)
        in_rooms = [scene for scene in every if scene.panel.layout != "led"] or list(every)
        self.crop_scenes = as_scenes(scenes, CROP_SHRINK)
        self.near, self.far = as_scenes(in_rooms, CROP_SHRINK), as_scenes(in_rooms, WHOLE_SHRINK)
        # one camera does for prints, which have no pattern; each scene takes time to be planned
        no_pattern = with_values(Scene.preset("phone_at_monitor"), {"sensor.exposure": "mean"})
        self.prints = no_pattern.with_shrink(CROP_SHRINK)

    @torch.no_grad()
    def __getitem__(self, number: int) -> list[Example]:
        """Return the examples of a number: of each look, screens and others."""
        rng = np.random.default_rng((self.seed, number))
        return [*self.crops(rng), *self.wholes(rng)]

    def crops(self, rng: np.random.Generator) -> list[Example]:
        """Return crops: a picture, its photo off a screen and the photo's twin; and another as a
        part of a screen, and of a print, often with the edge."""
        side = int(rng.integers(*CUT_SIDES))
        size = (side, side)
        original = _as_batch(part_of(rng, self.shown(rng, side), size))
        shot = sample_one(self.crop_scenes, size, _generator(rng))
        photo, twin = capture(original, shot), capture(original, without_moire(shot))
        found = [("original", original, False)]
        if moire_codes(photo, twin).item() >= MIN_MOIRE:
            found += [("photo", photo, True), ("twin", twin, False)]
        else:
            found.append(("photo without moiré", photo, True))
        shown = self.shown(rng, PHOTO_SIDE)
        around = _as_batch(part_of(rng, self.ordinary(rng), size))
        part = screen(rng, shown, around, self.near, NEAR)
        if part.shares.item() > MIN_SHARE:
            found.append(("part of a screen", part.photos, True))
        found.append(("part of a print", print_of(rng, shown, around, self.prints, NEAR), False))
        return _as_examples(rng, found, "crop", CROP_SIDE)

    def wholes(self, rng: np.random.Generator) -> list[Example]:
        """Return whole photos of one picture and one room: both as they are and by a camera, and
        the picture on a screen, in the room or filling the photo. Small photos of prints look like
        those of screens."""
        size = (PHOTO_SIDE, int(PHOTO_SIDE * rng.choice([0.75, 0.75, 9 / 16])))
        size = size if rng.random() < 0.5 else size[::-1]
        shown, around = self.shown(rng, PHOTO_SIDE), self.ordinary(rng)
        picture, room = _as_batch(_cover(shown, size)), _as_batch(part_of(rng, around, size))
        shot = sample_one(self.far, size, _generator(rng))
        photo, twin = capture(picture, shot), capture(picture, without_moire(shot))
        found = [
            ("picture", picture, False),
            ("picture by a camera", twin, False),
            ("room", room, False),
            ("room by a camera", capture(room, without_moire(shot)), False),
            ("screen in a room", screen(rng, shown, room, self.far, WHOLE).photos, True),
        ]
        if moire_codes(photo, twin).item() >= MIN_MOIRE:
            found.append(("screen", photo, True))
        return _as_examples(rng, found, "whole", WHOLE_SIDE)

    def ordinary(self, rng: np.random.Generator) -> Image.Image:
        """Draw a picture, as large as a detector looks at it."""
        return shrunk(self.pictures.draw(rng)[1])

    def shown(self, rng: np.random.Generator, side: int) -> Image.Image:
        """Draw a picture that a screen or a page shows."""
        if rng.random() >= DRAWN:
            return self.ordinary(rng)
        draw = (drawn_pictures.page, drawn_pictures.interface)[int(rng.integers(2))]
        return draw(rng, side)


def screen(
    rng: np.random.Generator,
    shown: Image.Image,
    around: Tensor,
    scenes: Scene | Mixture,
    room: Room,
) -> RoomPhotos:
    """Return the photo of a picture on a screen in a room, of the size of its surroundings."""
    picture = _as_batch(on_screen(rng, shown, _shape(rng)))
    return screen_in_room(picture, around, scenes, room, generator=_generator(rng))


def print_of(
    rng: np.random.Generator, shown: Image.Image, around: Tensor, scene: Scene, room: Room
) -> Tensor:
    """Return the photo (1, 3, H, W) of a picture on a wall or a page on a table, which has the
    light of the room alone."""
    ambient = float(rng.uniform(*AMBIENT))
    light = light_of_codes(_as_batch(_cover(shown, _shape(rng))))
    printed = codes_of_light(light * ambient * float(rng.uniform(*REFLECTED)))
    room = replace(room, ambient=ambient, glow=0.0, albedo=(0.0, 1.5), bezel=(0.0, 0.15))
    return screen_in_room(printed, around, scene, room, generator=_generator(rng)).photos


def on_screen(rng: np.random.Generator, picture: Image.Image, size: tuple[int, int]) -> Image.Image:
    """Return a picture as screens show it: filling them, or in a viewer with bars around it."""
    height, width = size
    if rng.random() < 0.45:
        return _cover(picture, size)
    code = int(rng.choice([0, 15, 32, 45, 240, 255]))
    canvas = Image.new("RGB", (width, height), (code, code, code))
    room = rng.uniform(0.5, 1.0)
    factor = room * min(width / picture.width, height / picture.height)
    small = picture.resize(
        (max(1, int(picture.width * factor)), max(1, int(picture.height * factor)))
    )
    top = int(rng.uniform(0.3, 0.7) * (height - small.height))
    canvas.paste(small, ((width - small.width) // 2, top))
    for bar in (0, 1):  # of titles, and of tasks
        if rng.random() < 0.6:
            thick = max(4, int(rng.uniform(0.03, 0.08) * height))
            strip = drawn_pictures.interface(rng, 256).resize((width, 8 * thick))
            canvas.paste(strip.crop((0, 0, width, thick)), (0, bar * (height - thick)))
    return canvas


def saved(rng: np.random.Generator, photo: Tensor, side: int) -> Tensor:
    """Return a photo (1, 3, H, W) as a file holds it, saved as JPEG once or twice, and shrunk to
    (3, side, side) uint8."""
    image = through_jpeg(picture_of(rounded(photo[0])), int(rng.integers(60, 97)))
    if rng.random() < 0.5:
        if image.height != side and rng.random() < 0.5:
            image = image.resize((side, side), Image.Resampling.LANCZOS)
        image = through_jpeg(image, int(rng.integers(60, 97)))
    if image.size != (side, side):
        image = image.resize((side, side), Image.Resampling.LANCZOS)
    if rng.random() < 0.5:
        image = image.transpose(Image.Transpose.FLIP_LEFT_RIGHT)
    return codes_of(image)


def _as_examples(
    rng: np.random.Generator, found: list[tuple[str, Tensor, bool]], look: str, side: int
) -> list[Example]:
    """Return examples of photos (1, 3, H, W), each with its kind and whether it is a screen."""
    return [
        Example(saved(rng, image, side), look, is_screen, kind) for kind, image, is_screen in found
    ]


def _shape(rng: np.random.Generator) -> tuple[int, int]:
    """Draw height and width of a shown picture."""
    aspect = float(rng.choice(ASPECTS))
    if aspect < 1:
        return PHOTO_SIDE, int(PHOTO_SIDE * aspect)
    return int(PHOTO_SIDE / aspect), PHOTO_SIDE


def _cover(picture: Image.Image, size: tuple[int, int]) -> Image.Image:
    """Return the middle of a picture, scaled until it fills a size (height, width)."""
    height, width = size
    factor = max(width / picture.width, height / picture.height)
    w, h = max(width, round(picture.width * factor)), max(height, round(picture.height * factor))
    left, top = (w - width) // 2, (h - height) // 2
    return picture.resize((w, h), Image.Resampling.BICUBIC).crop(
        (left, top, left + width, top + height)
    )


def part_of(rng: np.random.Generator, picture: Image.Image, size: tuple[int, int]) -> Image.Image:
    """Return a part of a picture at its own pixels, enlarged only if it is smaller."""
    height, width = size
    if picture.height < height or picture.width < width:
        return _cover(picture, size)
    left = int(rng.integers(picture.width - width + 1))
    top = int(rng.integers(picture.height - height + 1))
    return picture.crop((left, top, left + width, top + height))


def _as_batch(picture: Image.Image) -> Tensor:
    return codes_of(picture)[None].float() / 255


def _generator(rng: np.random.Generator) -> torch.Generator:
    return torch.Generator().manual_seed(int(rng.integers(2**32)))
