"""The command that cleans a folder: what stays, what is named; nothing is overwritten."""

import re
from unittest.mock import Mock

import numpy as np
import pytest
import torch
from PIL import Image, ImageOps

from moireaug.defenses import demoire
from training import demoire as command
from training.demoireing import clean as cleaning
from training.demoireing.train import start_as_identity


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """A network that gives back what it is given."""
    path = tmp_path_factory.mktemp("weights") / "weights.pt"
    network = demoire.build("esdnet", width=0.25)
    assert start_as_identity(network)
    demoire.save(network, path)
    return path


@pytest.fixture
def photos(tmp_path):
    """Photos of several formats, sizes and modes, one of them torn, and what is no photo."""
    folder = tmp_path / "photos"
    (folder / "deep").mkdir(parents=True)
    draw = np.random.default_rng(2)
    shades = draw.integers(0, 256, (9, 7, 3), dtype=np.uint8)
    smooth = Image.fromarray(shades).resize((70, 45), Image.Resampling.BICUBIC)
    exif = Image.Exif()
    exif[0x010F], exif[0x0112] = "camera", 6  # turned by a quarter
    smooth.save(folder / "a.jpg", quality=95, exif=exif)
    smooth.save(folder / "deep" / "B.PNG", icc_profile=bytes(16) + b"RGB " + bytes(108))
    smooth.convert("L").save(folder / "grey.bmp", icc_profile=bytes(16) + b"GRAY")
    smooth.resize((300, 1)).save(folder / "line.webp", lossless=True)
    smooth.save(folder / "c.tiff")
    whole = (folder / "deep" / "B.PNG").read_bytes()
    (folder / "torn.png").write_bytes(whole[: len(whole) // 2])
    (folder / "notes.txt").write_text("no photo")
    return folder


def opened(path):
    with Image.open(path) as image:
        image.load()
        return image


def pixels(path):
    return np.asarray(ImageOps.exif_transpose(opened(path)).convert("RGB")).astype(int)


def test_the_command_cleans_readable_photos_and_names_the_rest(photos, weights, tmp_path, capsys):
    out = tmp_path / "out"
    with pytest.raises(SystemExit, match=r"^error: not every photo could be cleaned: 1 failed"):
        command.main(["clean", f"in={photos}", f"out={out}", f"weights={weights}", "tile=256"])
    said = capsys.readouterr()
    assert "torn.png could not be read" in said.err
    assert said.out.startswith(f"Photos cleaned into {out}: 5")
    assert "not pictures by their names: 1." in said.out
    written = {p.relative_to(out).as_posix() for p in out.rglob("*") if p.is_file()}
    assert written == {"a.jpg", "deep/B.PNG", "grey.bmp", "line.webp", "c.tiff"}
    for name in written:
        apart = np.abs(pixels(out / name) - pixels(photos / name))
        assert apart.mean() < 2 if name == "a.jpg" else not apart.any(), name
        assert opened(out / name).format == opened(photos / name).format
    assert dict(opened(out / "a.jpg").getexif()) == {0x010F: "camera"}
    assert opened(out / "deep/B.PNG").info["icc_profile"][16:20] == b"RGB "
    assert "icc_profile" not in opened(out / "grey.bmp").info


def test_a_large_photo_is_cleaned_by_its_network(weights, tmp_path):
    torch.manual_seed(0)
    network = demoire.build("esdnet", width=0.125).eval()
    demoire.save(network, tmp_path / "other.pt")
    (tmp_path / "in").mkdir()
    shades = np.random.default_rng(0).integers(0, 256, (40, 300, 3), dtype=np.uint8)
    Image.fromarray(shades).save(tmp_path / "in" / "a.png")
    given = [f"in={tmp_path / 'in'}", f"weights={tmp_path / 'other.pt'}"]
    cleaning.main([*given, f"out={tmp_path / 'whole'}"])
    cleaning.main([*given, f"out={tmp_path / 'tiled'}", "tile=256"])
    images = torch.from_numpy(shades).permute(2, 0, 1)[None].float() / 255
    with torch.no_grad():
        wanted = (255 * network(images)[0]).round().permute(1, 2, 0).numpy()
    assert np.abs(pixels(tmp_path / "whole/a.png") - wanted).max() <= 1
    apart = np.abs(pixels(tmp_path / "tiled/a.png") - wanted)
    assert apart.max() > 0 and apart.mean() < 4, "tiles of a network that looks at means"
    cleaning.main([*given, f"out={tmp_path / 'off'}", "tile=280"])  # rounded down to 256
    assert np.array_equal(pixels(tmp_path / "off/a.png"), pixels(tmp_path / "tiled/a.png"))


def test_a_full_disk_leaves_no_half_written_photo(photos, weights, tmp_path, monkeypatch):
    monkeypatch.setattr("os.fsync", Mock(side_effect=OSError(28, "No space left on device")))
    with pytest.raises(SystemExit, match=r"error: .*No space left"):
        cleaning.main([f"in={photos}", f"out={tmp_path / 'out'}", f"weights={weights}"])
    assert not [p for p in (tmp_path / "out").rglob("*") if p.is_file()]


SENTENCES = [
    (["in={photos}", "out={photos}"], "are one folder, or one lies in the other"),
    (["in={photos}", "out={photos}/deep/out"], "are one folder, or one lies in the other"),
    (["in={photos}/deep", "out={photos}"], "are one folder, or one lies in the other"),
    (["in={photos}", "out={photos}.txt"], "there is a file of that name"),
    (["in={photos}"], "out must be given, as in"),
    (["in={photos}", "out=o", "weights=nowhere.pt"], "no weights file 'nowhere.pt'"),
    (["in=nowhere", "out=o"], "nowhere is not a folder"),
    (["in={photos}", "out=o", "tile=100"], "tile must be at least 256"),
    (["in={photos}", "out=o", "device=tpu9"], "Use device=cpu"),
    (["in={photos}", "out=o", "device=meta"], "one of cpu, cuda, mps; got meta. Use device=cpu"),
    (["inn={photos}"], "Did you mean 'in'?"),
]


def test_wrong_settings_get_a_sentence(photos, weights, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    photos.with_suffix(".txt").write_text("a file")
    before = sorted(photos.rglob("*"))
    for given, sentence in SENTENCES:
        argv = [argument.format(photos=photos) for argument in given]
        if not any(argument.startswith("weights=") for argument in argv):
            argv.append(f"weights={weights}")
        with pytest.raises(SystemExit, match=re.escape(sentence)):
            cleaning.main(argv)
        assert sorted(photos.rglob("*")) == before and not (tmp_path / "o").exists(), given


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "in").mkdir()
    return tmp_path / "in"


def test_a_photo_that_needs_too_much_memory_is_named(folder, weights, monkeypatch, capsys):
    Image.new("RGB", (40, 30)).save(folder / "1.png")
    given = [f"in={folder}", f"out={folder.parent / 'out'}", f"weights={weights}"]
    for error in (
        MemoryError(),
        torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB"),
        RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried to allocate 9 bytes"),
    ):
        monkeypatch.setattr(cleaning, "tiled", Mock(side_effect=error))
        with pytest.raises(SystemExit, match="1 failed"):
            cleaning.main(given)
        assert "1.png needs more memory than there is: pass tile=256" in capsys.readouterr().err


def test_a_photo_that_cannot_be_encoded_is_named(folder, weights, tmp_path, capsys):
    picture, exif = Image.new("RGB", (40, 30), "red"), Image.Exif()
    exif[0x010E] = "x" * 70_000  # more than a JPEG holds
    picture.save(folder / "1.png", exif=exif)
    (folder / "1.png").rename(folder / "1.jpg")
    long = "图" * 80 + ".png"  # 244 bytes
    picture.save(folder / long)
    Image.new("L", (40, 30), 90).save(folder / "grey.pgm")
    with pytest.raises(SystemExit, match="1 failed"):
        cleaning.main([f"in={folder}", f"out={tmp_path / 'out'}", f"weights={weights}"])
    assert "1.jpg could not be written: EXIF data is too long" in capsys.readouterr().err
    assert {path.name for path in (tmp_path / "out").iterdir()} == {long, "grey.pgm"}
    assert opened(tmp_path / "out/grey.pgm").mode == "L", "a file of greys stays one"
