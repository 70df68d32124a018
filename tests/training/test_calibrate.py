"""calibrate.py: pairs and photos in, a table and a page out."""

import csv
from dataclasses import replace

import pytest
import torch
from PIL import Image

from moireaug import Develop, Scene, Sensor, View
from tests.training.screens import PLAIN, picture
from training import calibrate
from training.calibration.compare import (
    compare_statistics,
    cut_crops,
    mean_distance,
    measure_crops,
    photograph_crops,
)
from training.config import scenes
from training.data.real_pairs import find_pairs, read_pairs
from training.photographs.statistics import STATISTICS

PAIRED_STATISTICS = {"psnr", "psnr_mapped", "sharpness"}  # which compare with the original


def photo_of(scene, shown, seed):
    as_batch = torch.from_numpy(shown).permute(2, 0, 1)[None]
    return photograph_crops(scene, as_batch, seed)[0].permute(1, 2, 0).numpy()


def table_in(path):
    return list(csv.DictReader(path.read_text().splitlines()))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Three pairs in two folders, photographed by a scene."""
    root = tmp_path_factory.mktemp("pairs")
    for kind in ("photo", "original"):
        (root / kind).mkdir()
    for seed in range(3):
        shown = picture(seed)
        Image.fromarray(shown).save(root / "original" / f"{seed}.png")
        Image.fromarray(photo_of(PLAIN, shown, seed)).save(root / "photo" / f"{seed}.png")
    return root


def test_the_command_compares_and_writes_a_page(folder, tmp_path, capsys):
    given = [f"pairs={folder}", "scene=screen_photo", f"out={tmp_path}", "size=64", "crops=2"]
    calibrate.main(given)
    out = capsys.readouterr().out
    assert "chroma, sigma 1.5 to 8" in out and "Mean distance" in out
    table = table_in(tmp_path / "statistics.csv")
    assert [row["name"] for row in table] == list(STATISTICS)
    assert all(float(row["real_10"]) <= float(row["real_90"]) for row in table)
    page = (tmp_path / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 1 + 3 * 3  # the plot, and three sides of a crop
    assert "http" not in page.split("</style>")[1]
    assert "screen_photo beside real photos" in page
    assert (tmp_path / "statistics.png").is_file()


def test_names_need_not_be_utf_8(folder, tmp_path, monkeypatch):
    """Of pairs, scenes and folders of results; tables and pages say "?"."""
    pairs = tmp_path / "pairs\udcfe"
    for kind in ("photo", "original"):
        (pairs / kind).mkdir(parents=True)
        (pairs / kind / "\udcff.png").hardlink_to(folder / kind / "0.png")
    (tmp_path / "s\udcfd.yaml").write_text("preset: screen_photo")
    monkeypatch.chdir(tmp_path)
    calibrate.main([f"pairs={pairs}", "scene=s\udcfd.yaml", "size=64", "crops=1"])
    (out,) = (tmp_path / "runs/calibrate").iterdir()
    assert out.name.startswith("pairs\udcfe-s\udcfd-")
    page = (out / "report.html").read_text()
    assert "s? beside real photos" in page and "<h3>?</h3>" in page


def test_a_scene_that_is_no_better_replaces_no_earlier_fit(folder, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(calibrate, "draw", lambda *_: b"")  # a plot takes longer than all else
    given = [f"pairs={folder}", "scene=screen_photo", f"out={tmp_path}", "size=32", "crops=1"]
    calibrate.main([*given, "fit=true", "evaluations=1"])
    said = capsys.readouterr().out
    assert "found no better ranges" in said and "fitted" not in said
    path = tmp_path / "scene.yaml"
    assert scenes.load(str(path)) == Scene.preset("screen_photo")
    calibrate.write_scene(path, PLAIN)
    calibrate.main([*given, "fit=true", "evaluations=1"])
    assert scenes.load(str(path)) == PLAIN


def test_photos_alone_are_measured_alone(folder, tmp_path, capsys):
    given = [f"photos={folder / 'photo'}", f"out={tmp_path}", "size=32", "crops=1"]
    calibrate.main(given)
    assert "Mean distance" not in capsys.readouterr().out
    table = table_in(tmp_path / "statistics.csv")
    assert STATISTICS.keys() - {row["name"] for row in table} == PAIRED_STATISTICS
    assert {row["simulated_50"] for row in table} == {""}


def test_photos_of_one_picture_are_registered_first(tmp_path, capsys):
    shown = picture(7, 240, 320)
    Image.fromarray(shown).save(tmp_path / "shown.png")
    (tmp_path / "photos").mkdir()
    view = View(yaw=12.0, roll=4.0)
    camera = replace(PLAIN, view=view, develop=Develop(linear_light=True, registered=False))
    Image.fromarray(photo_of(camera, shown, 0)).save(tmp_path / "photos" / "a.png")
    given = [f"photos={tmp_path / 'photos'}", f"picture={tmp_path / 'shown.png'}"]
    given += [f"out={tmp_path / 'out'}", "size=96", "crops=2"]
    cfg = calibrate.parse(given, calibrate.Config, calibrate.EXAMPLE, "")
    found = {line.name: line for line in calibrate.calibrate(cfg)}
    assert found["psnr_mapped"].real[1] > 22  # the photo lies on its picture
    Image.fromarray(picture(8, 240, 320)).save(tmp_path / "photos" / "b.png")
    with pytest.raises(SystemExit, match=r"not found in .*b\.png|b\.png could not be aligned"):
        calibrate.main(given)


WRONG = {
    "": "pass either pairs= or photos=, as in: python training/calibrate.py",
    "pair=x": "Did you mean 'pairs'",
    "pairs=x size=many": "size: ",
    "scene=paper": "pass either pairs= or photos=",
    "pairs=": "a setting is given as pairs=VALUE; got 'pairs='",
    "photos": "a setting is given as photos=VALUE; got 'photos'",
    "pairs=a photos=b": "pass either pairs= or photos=",
    "pairs=a picture=b": "leave it out with pairs=",
    "photos=a fit=true": "fit=true needs to know",
    "pairs=a size=8": "size must be at least 32",
    "pairs=a seed=4294967295": r"seed must be in \[0, 4294967294\]",  # the search takes the next
    "photos=. out=new": "out=new lies in photos=., and what is written would be taken for",
    "photos=.": r"out=runs/calibrate/\S* lies in photos=",
    "pairs=a scene=paper": "camera's frame",
    "pairs=nowhere.csv": "neither a CSV file nor a folder",
    "pairs=a scene=none.yaml": "could not be read",
}


def test_what_cannot_be_followed_ends_with_a_sentence(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for given, said in WRONG.items():
        with pytest.raises(SystemExit, match=f"^error: .*{said}"):
            calibrate.main(given.split())


def test_sources_of_one_name_have_their_own_folders(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    other = replace(PLAIN, sensor=Sensor(scale=3.0))
    photos = "photos.iphone12", "photos.pixel8"
    given = [({"pairs": f"{name}/shots.csv"}, PLAIN) for name in ("ca", "cb")]
    given += [({"photos": name}, PLAIN) for name in photos]
    given += [({"photos": photos[1], "picture": "a.png"}, PLAIN)]
    given += [({"pairs": "ca/shots.csv"}, other)]
    folders = [calibrate.folder_of(calibrate.Config(**one), scene) for one, scene in given]
    assert len(set(folders)) == len(given)
    same = calibrate.Config(pairs=str(tmp_path / "cb/../ca/shots.csv"))
    assert calibrate.folder_of(same, PLAIN) == folders[0]
    assert folders[2].name.startswith("photos.iphone12-screen_photo-")


def test_a_table_of_pairs_is_read_from_its_own_folder(folder, tmp_path):
    table = folder / "pairs.csv"
    table.write_text("photo,original\nphoto/0.png,original/0.png\n")
    crops = cut_crops(read_pairs(find_pairs(table)), 48, 3)
    assert crops.photos.shape == crops.originals.shape == (3, 3, 48, 48)
    for content, said in (
        (b"photo,original\nphoto/0.png,original/9.png\n", r"original/9\.png, .* does not exist"),
        (b"photo,picture\nphoto/0.png,original/0.png\n", "photo and original, .*; row 1 has"),
        (b"photo,original\nphoto/0.png\n", "filled in every line; row 1 has"),
        (b"\x80\x81\x00", r"pairs\.csv could not be read as a CSV file"),
    ):
        table.write_bytes(content)
        with pytest.raises(ValueError, match=said):
            find_pairs(table)
    # as Excel saves "CSV UTF-8"
    table.write_text("photo,original\nphoto/0.png,original/0.png\n", encoding="utf-8-sig")
    assert len(find_pairs(table)) == 1


def test_a_scene_is_nearest_to_itself():
    shown = [torch.from_numpy(picture(s, 64, 80)).permute(2, 0, 1) for s in range(6)]
    originals = torch.stack(shown)
    real = measure_crops(photograph_crops(PLAIN, originals, 1), originals)
    dark = replace(PLAIN, sensor=Sensor(scale=2.0, gain=1.2))
    same, other = (
        measure_crops(photograph_crops(scene, originals, 2), originals) for scene in (PLAIN, dark)
    )
    zero, near, far = (mean_distance(compare_statistics(real, it)) for it in (real, same, other))
    assert zero == 0 < near < 0.75 * far


def test_pairs_are_matched_within_their_folder(tmp_path):
    for kind, suffix in (("photo", "jpg"), ("original", "png")):
        for day in ("monday", "tuesday"):
            (tmp_path / kind / day).mkdir(parents=True)
            Image.fromarray(picture(1, 24, 32)).save(tmp_path / kind / day / f"1.{suffix}")
    for pair in find_pairs(tmp_path):
        assert pair.photo.parent.name == pair.original.parent.name
    (tmp_path / "photo/monday/._1.jpg").write_text("of a Mac")
    assert len(find_pairs(tmp_path)) == 2
    Image.fromarray(picture(1, 24, 32)).save(tmp_path / "original" / "monday" / "1.jpg")
    with pytest.raises(ValueError, match="more than one picture of its name"):
        find_pairs(tmp_path)


def test_a_crop_does_not_keep_its_photo(tmp_path):
    photo = torch.zeros(3, 300, 300, dtype=torch.uint8)
    crops = cut_crops([("a", photo, photo)], 16, 2)
    assert crops.photos.untyped_storage().nbytes() == 2 * 3 * 16 * 16
