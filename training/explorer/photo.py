"""The photo of one picture, a crop of it, and its spectrum."""

import time
from pathlib import Path
from typing import NamedTuple

import matplotlib
import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from moireaug.capture import capture
from moireaug.common import image_files
from moireaug.scenes import Scene, Shot
from training.data import signs

Picture = NDArray[np.uint8]  # (H, W, 3)

MAX_PIXELS = 2_000_000  # of a picture: about a second on one core
CROP_SIDE = 64  # pixels
MAGNIFICATION = 6  # of the crop


class TimedPhoto(NamedTuple):
    """A photo (1, 3, H, W) in [0, 1], its shot, and its time in seconds."""

    photo: Tensor
    shot: Shot
    seconds: float


def draw_sign() -> Picture:
    """Draw a traffic sign."""
    pictures, _ = signs.make("test", 10, size=256, seed=4)
    return pictures[9].permute(1, 2, 0).numpy()


def grey_screen() -> Picture:
    """Return a grey screen, on which only the effects of panel and camera show."""
    return np.full((256, 256, 3), 190, np.uint8)


def read_bundled(name: str) -> Picture:
    """Return one of scikit-image's own pictures, in RGB."""
    from skimage import data

    return np.asarray(Image.fromarray(getattr(data, name)()).convert("RGB"))


SAMPLES = {
    "cat": lambda: read_bundled("chelsea"),
    "page of text": lambda: read_bundled("page"),
    "traffic sign": draw_sign,
    "grey screen": grey_screen,
}


def read(path: str) -> Picture:
    """Return the picture in a file, upright."""
    width, height = image_files.size_of(path)
    if width * height > MAX_PIXELS:
        raise ValueError(
            f"{Path(path).name} has {width} x {height} pixels, more than the explorer's limit of "
            f"{MAX_PIXELS / 1e6:g} megapixels. Make it smaller, or use moireaug.capture, which "
            "takes any size."
        )
    return np.asarray(image_files.read_picture(path))


def as_batch(picture: Picture) -> Tensor:
    """Return a picture as (1, 3, H, W) in [0, 1]."""
    return torch.from_numpy(picture.copy()).permute(2, 0, 1)[None].float() / 255


def as_picture(photo: Tensor) -> Picture:
    """Return a photo (1, 3, H, W) in [0, 1] as 8-bit codes."""
    return (255 * photo[0]).round().to(torch.uint8).permute(1, 2, 0).numpy()


@torch.no_grad()
def photograph(image: Tensor, scene: Scene, seed: int) -> TimedPhoto:
    """Photograph a picture (1, 3, H, W) in [0, 1] off a screen."""
    size = (image.shape[-2], image.shape[-1])
    shot = scene.sample(1, size, torch.Generator().manual_seed(seed))
    start = time.perf_counter()
    photo = capture(image, shot)
    return TimedPhoto(photo, shot, time.perf_counter() - start)


def magnify(photo: Picture, x: float = 0.5, y: float = 0.5) -> Picture:
    """Return a magnified crop around a point of a photo.

    Args:
        x, y: the point, as shares of the photo's width and height.
    """
    height, width = photo.shape[:2]
    top = min(max(0, round(y * height) - CROP_SIDE // 2), max(0, height - CROP_SIDE))
    left = min(max(0, round(x * width) - CROP_SIDE // 2), max(0, width - CROP_SIDE))
    crop = photo[top : top + CROP_SIDE, left : left + CROP_SIDE]
    return crop.repeat(MAGNIFICATION, 0).repeat(MAGNIFICATION, 1)


def spectrum(photo: Picture, side: int = CROP_SIDE * MAGNIFICATION) -> Picture:
    """Return a photo's power spectrum, logarithmic and in false colours: frequency zero in the
    middle, half a cycle per pixel at the edges.

    It is the mean over red, green and blue, under a Hann window. Moiré shows as pairs of points."""
    height, width = photo.shape[:2]
    window = np.hanning(height)[:, None, None] * np.hanning(width)[None, :, None]
    codes = photo.astype(np.float32)
    waves = np.fft.fft2((codes - codes.mean((0, 1))) * window, axes=(0, 1))
    power = np.fft.fftshift(np.log10(np.square(np.abs(waves)).mean(2) + 1.0))
    low, high = np.percentile(power, 30), power.max()
    grey = ((power - low) / max(high - low, 1e-6)).clip(0, 1)
    colours = matplotlib.colormaps["magma"](grey, bytes=True)[..., :3]
    square = Image.fromarray(colours).resize((side, side), Image.Resampling.BICUBIC)
    return np.asarray(square)
