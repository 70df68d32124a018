"""Image files as data: every mode and damage gives the right picture or a sentence."""

import io
import struct
import zlib

import cv2
import numpy as np
import pytest
from PIL import Image, ImageOps

from moireaug.common.image_files import read_picture, size_of
from training.config.data_sets import Data
from training.data.load import load

SIDE = 8
RAMP = np.arange(SIDE * SIDE).reshape(SIDE, SIDE) * 4 + 1  # grey, 1 to 253
COLOURS = np.stack([RAMP, RAMP.T, 254 - RAMP], -1).astype(np.uint8)


def rgb(grey):
    return np.stack([grey] * 3, -1).astype(np.uint8)


def pil(image, kind="png", **options):
    file = io.BytesIO()
    image.save(file, kind, **options)
    return file.getvalue()


def cv(values, kind="png"):
    return cv2.imencode(f".{kind}", values)[1].tobytes()


def deep(values):
    """8 bits as 16, whose low byte is another number."""
    return values.astype(np.uint16) * 256 + 77


def of(mode, values=None):
    return Image.fromarray((RAMP if values is None else values).astype(np.uint8)).convert(mode)


def with_alpha(mode):
    """Of which the left half hides what is under it."""
    image = of("RGB", COLOURS).convert(mode.removesuffix("A"))
    alpha = np.full((SIDE, SIDE), 255, np.uint8)
    alpha[:, : SIDE // 2] = 0
    image.putalpha(Image.fromarray(alpha))
    return image


def on_white(values):
    shown = values.copy()
    shown[:, : SIDE // 2] = 255
    return shown


def see_through_palette():
    image = of("P")
    return pil(image, transparency=int(image.getpixel((0, 0))))


FIRST_WHITE = rgb(np.where(RAMP == 1, 255, RAMP))
LUMA = np.array(of("RGB", COLOURS).convert("L"))
CMYK = of("RGB", COLOURS).convert("CMYK")
HIGH_BYTE_FIRST = Image.fromarray(deep(RAMP).astype(">u2"))
FILES = {
    "grey": (lambda: pil(of("L")), rgb(RAMP)),
    "RGB": (lambda: pil(of("RGB", COLOURS)), COLOURS),
    "1-bit": (lambda: pil(of("1", (RAMP > 99) * 255)), rgb((RAMP > 99) * 255)),
    "palette": (lambda: pil(of("P")), rgb(RAMP)),
    "palette, one colour transparent": (see_through_palette, FIRST_WHITE),
    "RGBA": (lambda: pil(with_alpha("RGBA")), on_white(COLOURS)),
    "LA": (lambda: pil(with_alpha("LA")), on_white(rgb(LUMA))),
    "CMYK": (lambda: pil(CMYK, "tiff"), np.array(CMYK.convert("RGB"))),
    "16-bit grey PNG": (lambda: cv(deep(RAMP)), rgb(RAMP)),
    "16-bit grey TIFF": (lambda: cv(deep(RAMP), "tiff"), rgb(RAMP)),
    "16-bit, high byte first": (lambda: pil(HIGH_BYTE_FIRST, "tiff"), rgb(RAMP)),
    "16-bit grey PGM": (lambda: cv(deep(RAMP), "pgm"), rgb(RAMP)),
    "16-bit RGB PNG": (lambda: cv(deep(COLOURS[..., ::-1])), COLOURS),
    "16-bit RGB TIFF": (lambda: cv(deep(COLOURS[..., ::-1]), "tiff"), COLOURS),
}


def folder(tmp_path, *contents, kind="png"):
    """A folder of two classes whose first test images of class "a" are those files."""
    for half in ("train", "test"):
        for name in ("a", "b"):
            (tmp_path / half / name).mkdir(parents=True)
            for i in range(2):
                Image.new("RGB", (SIDE, SIDE)).save(tmp_path / half / name / f"x{i}.png")
    for i, content in enumerate(contents):
        (tmp_path / "test" / "a" / f"{i:02d}.{kind}").write_bytes(content)
    data = load(Data(name="folder", root=str(tmp_path), size=SIDE, val=1)).test
    return tmp_path / "test" / "a" / f"00.{kind}", data


def test_every_mode_keeps_its_picture(tmp_path):
    _, data = folder(tmp_path, *(make() for make, _ in FILES.values()))
    for i, (name, (_, expected)) in enumerate(FILES.items()):
        image, label = data[i]
        assert label == 0 and np.array_equal(image.permute(1, 2, 0).numpy(), expected), name


def test_a_picture_keeps_its_exif_data_but_for_its_orientation(tmp_path):
    for mode in ("RGB", "RGBA", "I;16"):
        exif = Image.Exif()
        exif[271], exif[274] = "camera", 6
        Image.new(mode, (4, 3)).save(tmp_path / "x.png", exif=exif)
        del exif[274]
        assert read_picture(tmp_path / "x.png").info["exif"] == exif.tobytes(), mode


def test_a_files_head_gives_its_upright_size(tmp_path):
    for kind in ("jpg", "tiff"):
        for orientation in (1, 3, 6, 8, 9):
            path, exif = tmp_path / f"x.{kind}", Image.Exif()
            exif[274] = orientation
            Image.new("RGB", (4, 3)).save(path, exif=exif)
            with Image.open(path) as image:
                upright = ImageOps.exif_transpose(image)
            assert size_of(path) == read_picture(path).size == upright.size


def test_a_mode_of_unknown_white_is_refused_by_name(tmp_path):
    path, data = folder(tmp_path, b"", kind="tiff")
    for mode, image in {
        "I": Image.fromarray(RAMP.astype(np.int32)),
        "F": Image.fromarray(RAMP.astype(np.float32) / 255),
        "LAB": Image.frombytes("LAB", (SIDE, SIDE), COLOURS.tobytes()),
    }.items():
        path.write_bytes(pil(image, "tiff"))
        said = f"{path} could not be read .*mode is '{mode}'.*8 or 16 bits"
        with pytest.raises(ValueError, match=said):
            data[0]


def chunk(name, content):
    check = zlib.crc32(name + content)
    return struct.pack(">I", len(content)) + name + content + struct.pack(">I", check)


def png_of_size(side):
    """A few bytes that claim side x side grey pixels."""
    header = struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)
    parts = chunk(b"IHDR", header), chunk(b"IDAT", zlib.compress(bytes(1000))), chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


WHOLE = pil(Image.fromarray(np.random.default_rng(0).integers(0, 256, (64, 64, 3), dtype=np.uint8)))
DAMAGED = {
    "more pixels than PIL warns of": (png_of_size(10_000), "89478485 pixels"),
    "more pixels than PIL refuses": (png_of_size(60_000), "89478485 pixels"),
    "fewer rows than claimed": (png_of_size(5000), "truncated"),
    "cut in its middle": (WHOLE[: len(WHOLE) // 2], "truncated"),
    "cut in its header": (WHOLE[:20], "could not be read"),
    "empty": (b"", "it is empty, or of a format that is not known"),
    "a text": (b"not found", "it is empty, or of a format that is not known"),
    "a page": (b"<html>" * 99, "it is empty, or of a format that is not known"),
}


def test_a_file_that_is_no_picture_is_named(tmp_path):
    path, data = folder(tmp_path, b"")
    for name, (content, says) in DAMAGED.items():
        path.write_bytes(content)
        with pytest.raises(ValueError, match=f"The image {path} could not be read ") as error:
            data[0]
        assert says in str(error.value) and "\n" not in str(error.value), name
    for n in range(0, len(WHOLE) - 64, 499):
        path.write_bytes(WHOLE[:n])
        with pytest.raises(ValueError, match=f"The image {path} could not be read"):
            data[0]
