"""Clean a folder of photos of screens: each keeps its name, its size and its file format.

    python training/demoire.py clean in=DIR out=DIR

`weights` is by default "screen", the released weights; else the weights.pt of a run of
training/demoire.py train, or any file written by moireaug.defenses.demoire.save. Photos are
searched for in subfolders too; large ones are cleaned tile by tile. Photos that cannot be read are
named, and the command then exits with status 1. Colour profile and EXIF data are kept, except TIFF
tags and the orientation: what is written is upright. It has one page of 8 bits a channel, with
white in place of what was transparent. Every file is written whole or not at all."""

import io
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from omegaconf import MISSING
from PIL import Image
from torch import Tensor
from tqdm import tqdm

from moireaug.common.files import write_bytes
from moireaug.common.image_files import read_picture
from moireaug.defenses import demoire
from moireaug.defenses.demoire import DemoireNet
from moireaug.synthesis.pictures import Pictures
from training.config.plain_commands import parse, report_errors
from training.config.settings import setting
from training.data.codes import codes_of, picture_of, rounded
from training.demoireing.tiles import TILE_OVERLAP, TILE_SIDE, tiled
from training.system import machine

EXAMPLE = "python training/demoire.py clean in=DIR out=DIR"
DEVICES = ("cpu", "cuda", "mps")
JPEG_OPTIONS = {"quality": 95, "subsampling": "4:4:4"}  # much of the moiré that remains is colour
LOSSLESS_OPTIONS = {"lossless": True}
FORMAT_OPTIONS: dict[str, dict[str, Any]] = {
    ".jpg": JPEG_OPTIONS,
    ".jpeg": JPEG_OPTIONS,
    ".jfif": JPEG_OPTIONS,
    ".webp": LOSSLESS_OPTIONS,
}


@dataclass
class Config:
    """All settings of the command."""

    in_: str = setting(MISSING, "folder of photos")
    out: str = setting(MISSING, "folder of the results")
    weights: str = setting("screen", "released weights, or a file")
    device: str = setting("auto", "or cpu, cuda, cuda:1, mps")
    tile: int = setting(
        TILE_SIDE,
        "longest side cleaned at once, in pixels",
        bounds=(2 * TILE_OVERLAP, None),
    )


def configure(argv: Sequence[str]) -> Config:
    """Return the settings of a command line."""
    cfg = parse(argv, Config, EXAMPLE, __doc__)
    photos, out = Path(cfg.in_).resolve(), Path(cfg.out).resolve()
    if out.is_relative_to(photos) or photos.is_relative_to(out):
        raise ValueError(
            f"in={cfg.in_} and out={cfg.out} are one folder, or one lies in the other, and photos "
            "would be overwritten: name another folder for out=."
        )
    if out.exists() and not out.is_dir():
        raise ValueError(f"out={cfg.out} cannot be a folder: there is a file of that name.")
    return cfg


def device_of(name: str) -> torch.device:
    """Return the device of that name; "auto" is a GPU where there is one."""
    if name == "auto":
        return machine.device(name)
    try:
        device = torch.empty(0, device=name).device
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise ValueError(f"device={name} cannot be used ({reason}). Use device=cpu.") from error
    if device.type not in DEVICES:
        kinds = ", ".join(DEVICES)
        raise ValueError(f"device must be auto, or one of {kinds}; got {name}. Use device=cpu.")
    return device


def clean_folder(cfg: Config) -> list[str]:
    """Clean every photo of a folder; return a sentence for each that could not be cleaned.

    Raises:
        ValueError: no photos, weights that cannot be read, or no such device.
        OSError: the disk is full or not writable; what was written before is whole.
    """
    device = device_of(cfg.device)
    network = demoire.load(cfg.weights).to(device)
    tile = cfg.tile - cfg.tile % network.multiple  # tiles lie on the grid of the whole photo
    pictures = Pictures(cfg.in_, 1)
    failed: list[str] = []
    start = time.perf_counter()
    with tqdm(pictures.names, unit="photo", disable=None) as bar:
        for name in bar:
            path = pictures.folder / name
            try:
                photo = read_picture(path)
                content = encode_like(clean(network, photo, tile), photo, path.suffix)
            except (ValueError, MemoryError, RuntimeError) as error:
                problem = problem_of(error, path)
                failed.append(problem)
                bar.write(f"not cleaned: {problem}", file=sys.stderr)
                continue
            write_bytes(Path(cfg.out) / name, content)
    seconds = time.perf_counter() - start
    cleaned = len(pictures) - len(failed)
    print(f"Photos cleaned into {cfg.out}: {cleaned}, in {seconds:.1f} s.")
    if pictures.others:
        print(f"Files in {cfg.in_} that are not pictures by their names: {len(pictures.others)}.")
    return failed


def problem_of(error: Exception, path: Path) -> str:
    """Return why a photo could not be cleaned; an error that tells of a mistake in the code is
    raised again."""
    message = str(error)
    if isinstance(error, (MemoryError, torch.OutOfMemoryError)) or "allocate memory" in message:
        least = 2 * TILE_OVERLAP
        return f"{path} needs more memory than there is: pass tile={least}, or device=cpu."
    if not isinstance(error, ValueError):
        raise error
    if str(path) in message:
        return message
    return f"{path} could not be written: {message}"  # of the encoder, which knows no name


def clean(network: DemoireNet, photo: Image.Image, tile: int) -> Image.Image:
    """Return a photo, cleaned."""
    return picture_of(clean_codes(network, codes_of(photo), tile))


@torch.inference_mode()
def clean_codes(network: DemoireNet, photo: Tensor, tile: int = TILE_SIDE) -> Tensor:
    """Return a photo (3, H, W) uint8, cleaned, as 8-bit codes."""
    device = next(network.parameters()).device
    images = photo[None].to(device).float() / 255
    return rounded(tiled(network, images, tile)[0]).cpu()


def encode_like(picture: Image.Image, photo: Image.Image, suffix: str) -> bytes:
    """Return a picture encoded in the format of a suffix, with the profile and EXIF data of the
    photo that it was made from."""
    options = dict(FORMAT_OPTIONS.get(suffix.lower(), {}))
    if exif := photo.info.get("exif"):
        options["exif"] = exif
    profile = photo.info.get("icc_profile")
    if profile and profile[16:20] == b"RGB ":  # a CMYK or grey profile does not fit RGB pixels
        options["icc_profile"] = profile
    format_name = Image.registered_extensions()[suffix.lower()]
    if suffix.lower() == ".pgm":  # of greys alone, as its name says
        picture = picture.convert("L")
    file = io.BytesIO()
    picture.save(file, format_name, **options)
    return file.getvalue()


def main(argv: Sequence[str]) -> None:
    """Run the command line, or exit with a one-line error."""
    with report_errors("Interrupted. Every photo that was written is whole."):
        failed = clean_folder(configure(argv))
    if failed:
        raise SystemExit(
            f"error: not every photo could be cleaned: {len(failed)} failed, see above."
        )
