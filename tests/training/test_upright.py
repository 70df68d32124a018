"""Pictures that a phone took lying on its side are upright in all that is made from them."""

import numpy as np
import pytest
import torch
from PIL import Image, ImageOps

from moireaug.common.image_files import read_picture, size_of
from moireaug.defenses import demoire
from moireaug.synthesis import Pairs
from training.data.image_sets import UprightFolder
from training.data.real_pairs import PairFiles, read_codes, read_pairs, require_one_size
from training.demoireing import clean as cleaning
from training.demoireing.train import start_as_identity

SIDE = 16
ORIENTATION = 0x0112
ORIENTATIONS = range(1, 9)
SHADES = np.random.default_rng(0).integers(0, 256, (SIDE, SIDE, 3), dtype=np.uint8)


def photo_of(path, orientation, codes=SHADES):
    """Write a photo as a camera does, with the orientation in its EXIF data."""
    exif = Image.Exif()
    exif[ORIENTATION] = orientation
    Image.fromarray(codes).save(path, exif=exif)
    return path


def upright(path):
    with Image.open(path) as image:
        return np.asarray(ImageOps.exif_transpose(image))


def by_pairs(path):
    return Pairs(path.parent, "phone_at_monitor", SIDE).make_pair(0).original


READERS = {
    "file": lambda path: np.asarray(read_picture(path)),
    "pairs": lambda path: by_pairs(path).permute(1, 2, 0).numpy(),
    "folder of classes": lambda path: UprightFolder(path.parent.parent, np.asarray)[0][0],
    "calibration": lambda path: read_codes(path).permute(1, 2, 0).numpy(),
}


@pytest.mark.parametrize("kind", ["png", "tiff"])
def test_every_reader_gives_the_picture_upright(kind, tmp_path):
    for orientation in ORIENTATIONS:
        folder = tmp_path / str(orientation) / "a"
        folder.mkdir(parents=True)
        path = photo_of(folder / f"1.{kind}", orientation)
        for name, reader in READERS.items():
            assert np.array_equal(reader(path), upright(path)), (name, orientation)


def test_cleaned_photos_are_upright_and_say_nothing_else(tmp_path):
    torch.manual_seed(0)
    network = demoire.build("esdnet", width=0.25)
    assert start_as_identity(network)
    demoire.save(network, tmp_path / "weights.pt")
    folder, out = tmp_path / "in", tmp_path / "out"
    folder.mkdir()
    for orientation in ORIENTATIONS:
        photo_of(folder / f"{orientation}.png", orientation)
    cleaning.main([f"in={folder}", f"out={out}", f"weights={tmp_path / 'weights.pt'}"])
    for path in folder.iterdir():
        with Image.open(out / path.name) as cleaned:
            assert cleaned.getexif().get(ORIENTATION, 1) == 1
            assert np.array_equal(np.asarray(cleaned), upright(path)), path.name


def test_a_pair_is_of_one_size_as_it_is_shown(tmp_path):
    shown = SHADES[:12]
    original = tmp_path / "original.png"
    Image.fromarray(shown).save(original)
    pair = PairFiles(photo_of(tmp_path / "photo.png", 6, np.rot90(shown).copy()), original)
    require_one_size(pair)
    ((_, photo, picture),) = read_pairs([pair])
    assert torch.equal(photo, picture)


@pytest.mark.parametrize("exif", [b"Exif\0\0no TIFF", b"Exif\0\0MM\0*\0\0\0\x08\0\x09"])
@pytest.mark.filterwarnings("ignore:Corrupt EXIF data:UserWarning")
def test_damaged_exif_data_spoil_no_picture(exif, tmp_path):
    path = tmp_path / "a.png"
    Image.fromarray(SHADES[:12]).save(path, exif=exif)
    assert np.array_equal(np.asarray(read_picture(path)), SHADES[:12])
    assert size_of(path) == (SIDE, 12)
