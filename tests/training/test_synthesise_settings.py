"""Settings of the command that makes pairs: what it refuses, and that it writes nothing then."""

import csv
import json

import pytest
from filelock import FileLock
from PIL import Image

import moireaug
from moireaug import Scene, Shot
from moireaug.synthesis.pictures import Pictures
from tests.synthesis.folders import put
from tests.training.pairs import FEW, hashes, made
from training import synthesise


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return put(tmp_path / "pictures")


OTHER = {
    "n=12": "n: 10 there, 12 now",
    "seed=3": "seed: 0 there, 3 now",
    "encoding=jpeg": "encoding: png there, jpeg now",
    "scene=screen_photo": "scene.sensor.pitch: [1.2, 2.1] there, [1.3, 2.2] now",
    "per_shard=5": "per_shard: 4 there, 5 now",
}


def test_other_settings_are_refused_in_the_same_folder(tmp_path):
    before = made(tmp_path / "out", "shard=0/3")
    for given, said in OTHER.items():
        with pytest.raises(SystemExit, match=r"holds a data set with other settings") as end:
            made(tmp_path / "out", given)
        assert said in end.value.code and hashes(tmp_path / "out") == before


def test_other_pictures_are_refused_in_the_same_folder(tmp_path, folder):
    made(tmp_path / "out", "shard=0/3")
    Image.new("RGB", (50, 50)).save(folder / "new.png")
    with pytest.raises(SystemExit, match=r"images\.files: 3 there, 4 now; images\.sha256: "):
        made(tmp_path / "out")


def test_settings_without_a_usable_picture_do_not_claim_the_folder(tmp_path):
    with pytest.raises(SystemExit, match="usable"):
        made(tmp_path / "out", "size=5000")
    made(tmp_path / "out")
    assert (tmp_path / "out/dataset.json").is_file()


def test_a_folder_that_is_something_else_is_refused(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out/000000.tar").write_text("of someone else")
    with pytest.raises(SystemExit, match=r"holds files, but no dataset\.json"):
        made(tmp_path / "out")
    (tmp_path / "out/dataset.json").write_text("{")
    with pytest.raises(SystemExit, match=r"dataset\.json is damaged"):
        made(tmp_path / "out")
    assert hashes(tmp_path / "out").keys() == {"000000.tar", "dataset.json"}


def test_a_set_by_another_version_is_not_continued(tmp_path):
    made(tmp_path / "out", "shard=0/3")
    path = tmp_path / "out/dataset.json"
    content = json.loads(path.read_text())
    made_with = content["made_with"]
    assert made_with["moireaug"] == moireaug.__version__
    path.write_text(json.dumps(content | {"made_with": made_with | {"moireaug": "0.1.0"}}))
    with pytest.raises(SystemExit, match=r"moireaug 0\.1\.0 has begun.* another out=DIR"):
        made(tmp_path / "out")
    del made_with["moireaug"]  # as sets were before it was noted
    path.write_text(json.dumps(content))
    made(tmp_path / "out", "shard=1/3")
    assert len(hashes(tmp_path / "out")) == 3


def test_different_shards_do_not_lock_each_other_out(tmp_path):
    made(tmp_path / "out", "shard=0/3")
    with FileLock(tmp_path / "out/.shard-0-of-3.lock"):
        made(tmp_path / "out", "shard=1/3")
        with pytest.raises(SystemExit, match="another command is at work on shard=0/3"):
            made(tmp_path / "out", "shard=0/3")
    assert sorted(p.name for p in (tmp_path / "out").glob("0*")) == ["000000.tar", "000001.tar"]


def test_a_scene_may_be_a_file(tmp_path):
    (tmp_path / "dim.yaml").write_text("preset: phone_at_monitor\nsensor: {gain: 1.5}\n")
    made(tmp_path / "out", "scene=dim.yaml", "shard=0/3", "format=imagefolder")
    settings = json.loads((tmp_path / "out/dataset.json").read_text())["settings"]
    with (tmp_path / "out/000000/metadata.csv").open() as file:
        shots = [Shot.from_dict(json.loads(row["shot"])) for row in csv.DictReader(file)]
    for scene in (Scene.from_dict(settings["scene"]), shots[0].scene):
        assert scene.sensor.gain == 1.5
        assert scene.view == Scene.preset("phone_at_monitor").view


WRONG = {
    "sed=1": r"a setting must be one of .*; got 'sed'. Did you mean 'seed'",
    "twin": "a setting is given as twin=VALUE",
    "n=1e6": r"n: Value '1e6' of type 'str' could not be converted to Integer",
    "out=null": "out: ",
    "out=${DIR}": "DIR",
    "shrink=[1,3": r"shrink=\[1,3 cannot be read: pass shrink=\[1,3\], say",
    "shard=3/3": r"0 <= i < n, .*; got 3/3. It counts from 0: with Slurm, --array=0-15",
    "shard=1": "shard must be i/n",
    "format=zip": "format must be one of 'webdataset', 'imagefolder'",
    "encoding=jpg": "encoding must be one of .* Did you mean 'jpeg'",
    "quality=90": "PNG is lossless: leave it out",
    "encoding=jpeg quality=0": r"quality must be in \[1, 100\]; got 0",
    "workers=-1": r"workers must be in \[0, 1024\]",
    "scene=paper": "leaves its photos in the camera's frame",
    "scene=none.yaml": r"scene=none.yaml could not be read \(No such file or directory\)",
    "images=nowhere": "nowhere is not a folder",
    "out=pictures/pairs": "would be taken for pictures",
    "out=pictures/class0/0.png": "would be taken for pictures",
    "out=file": "cannot be a folder: there is a file of that name",
}


def test_a_wrong_command_line_is_refused_before_any_writing(tmp_path):
    (tmp_path / "file").touch()
    before = hashes(tmp_path)
    for given, said in WRONG.items():
        with pytest.raises(SystemExit, match=f"^error: .*{said}"):
            synthesise.main([*FEW, "images=pictures", "out=out", *given.split()])
        assert hashes(tmp_path) == before, given
    with pytest.raises(SystemExit, match=r"^error: images, n, out must be given, as in: python"):
        synthesise.main([])


def test_links_to_nothing_and_in_circles_are_no_pictures(tmp_path, folder):
    names = Pictures(folder, 1).names
    (folder / "gone.png").symlink_to(tmp_path / "nowhere.png")
    (folder / "class0/again").symlink_to(folder)
    assert Pictures(folder, 1).names == names
