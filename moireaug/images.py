"""Read image files as RGB, with errors that name the file."""

from __future__ import annotations

import warnings

import numpy as np
from PIL import Image, UnidentifiedImageError

KEPT = ("exif", "icc_profile")
DEEP = ("I;16", "I;16L", "I;16B")  # 16-bit grey
AS_RGB = (
    "1",
    "L",
    "P",
    "RGB",
    "CMYK",
    "YCbCr",
    "HSV",
)  # modes that PIL converts to RGB unambiguously


def read(path: str) -> Image.Image:
    """Return the picture in a file, in mode RGB.

    16-bit grey keeps its high byte, as PIL does with 16-bit RGB. Transparent pixels are put on
    white, as on a page. EXIF data and colour profile stay in its `info`.

    Raises:
        ValueError: the file is missing, damaged, not an image, too large
            (`PIL.Image.MAX_IMAGE_PIXELS`), or of a mode whose black and white are not known, such
            as 32-bit numbers.
    """
    try:
        with open(path, "rb") as file, warnings.catch_warnings():
            # PIL only warns of a suspicious size, and opens the file all the same
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            image = Image.open(file)
            picture = _rgb(image)
            for name in KEPT:
                if name in image.info:
                    picture.info[name] = image.info[name]
            return picture
    # depending on the damaged byte: OSError, SyntaxError, struct.error, EOFError, ...
    except Exception as error:
        raise ValueError(
            f"The image {path} could not be read ({_why(error)}). Remove or replace the file."
        ) from error


def _rgb(image: Image.Image) -> Image.Image:
    # PIL opens 16-bit PGM files as 32-bit numbers, stretched to 65535
    if image.mode in DEEP or (image.mode == "I" and image.format == "PPM"):
        return _high_byte(image)
    if image.has_transparency_data:
        return _on_white(image)
    if image.mode not in AS_RGB:
        raise ValueError(
            f"its mode is {image.mode!r}, whose black and white are not known; save it with 8 or "
            f"16 bits"
        )
    return image.convert("RGB")


def _high_byte(image: Image.Image) -> Image.Image:
    values = np.asarray(image).astype(np.int64)
    return Image.fromarray((values >> 8).astype(np.uint8)).convert("RGB")


def _on_white(image: Image.Image) -> Image.Image:
    shown = image.convert("RGBA")
    page = Image.new("RGBA", shown.size, "white")
    return Image.alpha_composite(page, shown).convert("RGB")


def _why(error: Exception) -> str:
    if isinstance(error, UnidentifiedImageError):  # its own message names a Python object
        return "it is empty, or not an image of a known format"
    if isinstance(error, (Image.DecompressionBombWarning, Image.DecompressionBombError)):
        most = Image.MAX_IMAGE_PIXELS
        return f"it has more than {most} pixels, PIL's limit against decompression bombs"
    return str(error) or type(error).__name__
