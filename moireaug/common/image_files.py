"""Read image files upright and in RGB, with errors that name the file."""

from __future__ import annotations

import contextlib
import struct
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError

KEPT_INFO_KEYS = ("exif", "icc_profile")
ORIENTATION = 0x0112  # the key in EXIF data
TRANSPOSED_ORIENTATIONS = (5, 6, 7, 8)  # orientations with width and height exchanged
# what PIL raises for damaged EXIF data depends on the byte
DAMAGED_EXIF = (
    *(SyntaxError, struct.error, EOFError),
    *(AttributeError, TypeError, ValueError, LookupError, ArithmeticError),
)
DEEP_GREY_MODES = ("I;16", "I;16L", "I;16B")  # 16-bit grey
# that PIL converts unambiguously
RGB_CONVERTIBLE_MODES = ("1", "L", "P", "RGB", "CMYK", "YCbCr", "HSV")


def read_picture(path: str | Path) -> Image.Image:
    """Return the picture in a file, in mode RGB, upright as its EXIF data say.

    16-bit grey keeps its high byte, as PIL does with 16-bit RGB. Transparent pixels are put on
    white, as on a page. Colour profile and EXIF data stay in its `info`, the latter without the
    orientation; damaged EXIF data are ignored.

    Raises:
        ValueError: the file is missing, damaged, not an image, above `PIL.Image.MAX_IMAGE_PIXELS`,
            or of a mode whose black and white are not known, such as 32-bit numbers.
    """
    with _opened(path) as image:
        image.load()
        try:
            ImageOps.exif_transpose(image, in_place=True)
        except DAMAGED_EXIF:
            image.info.pop("exif", None)
        picture = _rgb(image)
        picture.info |= {key: image.info[key] for key in KEPT_INFO_KEYS if key in image.info}
        return picture


def size_of(path: str | Path) -> tuple[int, int]:
    """Return width and height of the picture that `read_picture` returns, without decoding it;
    errors as there, as far as the head of the file tells."""
    with _opened(path) as image:
        width, height = image.size
        if image.format == "TIFF":  # PIL gives its size upright
            return width, height
        with contextlib.suppress(*DAMAGED_EXIF):
            if image.getexif().get(ORIENTATION) in TRANSPOSED_ORIENTATIONS:
                return height, width
        return width, height


@contextlib.contextmanager
def _opened(path: str | Path) -> Iterator[Image.Image]:
    """Open an image file; whatever goes wrong until it is closed gets a sentence."""
    try:
        with open(path, "rb") as file, warnings.catch_warnings():
            # PIL only warns of a suspicious size, and opens the file all the same
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            yield Image.open(file)
    except Exception as error:  # which one depends on the damaged byte
        raise ValueError(
            f"The image {path} could not be read ({_why(error)}). Check the path, and "
            "replace or remove a damaged file."
        ) from error


def _rgb(image: Image.Image) -> Image.Image:
    # PIL opens 16-bit PGM files as 32-bit numbers, stretched to 65535; old ones also 16-bit PNG
    if image.mode in DEEP_GREY_MODES or (image.mode == "I" and image.format in ("PPM", "PNG")):
        high_byte = np.asarray(image).astype(np.int64) >> 8
        return Image.fromarray(high_byte.astype(np.uint8)).convert("RGB")
    if image.has_transparency_data:
        page = Image.new("RGBA", image.size, "white")
        return Image.alpha_composite(page, image.convert("RGBA")).convert("RGB")
    if image.mode not in RGB_CONVERTIBLE_MODES:
        raise ValueError(
            f"its mode is {image.mode!r}, whose black and white are not known; save it with 8 or "
            "16 bits"
        )
    return image.convert("RGB")


def _why(error: Exception) -> str:
    if isinstance(error, UnidentifiedImageError):  # its own message names a Python object
        return "it is empty, or of a format that is not known, such as a TIFF of floats in colour"
    if isinstance(error, (Image.DecompressionBombWarning, Image.DecompressionBombError)):
        most = Image.MAX_IMAGE_PIXELS
        return f"it has more than {most} pixels, PIL's limit against decompression bombs"
    return str(error) or type(error).__name__
