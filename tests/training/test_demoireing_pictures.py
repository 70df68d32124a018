"""Which pictures train, validate and test a demoiréing network."""

import pytest
from PIL import Image

from moireaug.synthesis.pictures import Pictures
from tests.synthesis.folders import put
from tests.training.test_demoireing import configure
from training.demoireing import fit as demoireing
from training.demoireing import pictures
from training.demoireing import train as demoireing_training
from training.runs import resume
from training.runs.run import Run

pytestmark = pytest.mark.usefixtures("as_the_command_is")


def test_pictures_that_test_are_not_trained_on(tmp_path):
    put(tmp_path, sizes=[(64, 64)] * 23)
    cfg = configure(f"data.root={tmp_path}")
    splits = pictures.load(cfg)
    names = [set(part.names) for part in splits]
    assert [len(part) for part in names] == [19, 2, 2]
    assert set.union(*names) == set(Pictures(tmp_path, 1).names)
    assert pictures.load(cfg).test.names == splits.test.names
    (tmp_path / "class0").rename(tmp_path / "train")
    (tmp_path / "class1").rename(tmp_path / "test")
    train, val, test = pictures.load(cfg)
    assert (len(train), len(val), len(test)) == (11, 1, 11)


@pytest.mark.parametrize(("named", "fewest"), [(("train", "test"), 2), (("a", "b"), 3)])
def test_one_picture_of_each_part_is_enough(tmp_path, named, fewest):
    """What lies in test/ is not taken from train/."""
    for name in named:
        (tmp_path / name).mkdir()
    cfg = configure(f"data.root={tmp_path}")
    Image.new("RGB", (64, 64)).save(tmp_path / named[1] / "0.png")
    held = fewest if named[0] == "train" else fewest - 1
    for number in range(held - 1):
        Image.new("RGB", (64, 64)).save(tmp_path / named[0] / f"{number}.png")
    with pytest.raises(ValueError, match=rf"holds {fewest - 1} pictures?: at least {fewest} are"):
        pictures.load(cfg)
    Image.new("RGB", (64, 64)).save(tmp_path / named[0] / "last.png")
    assert [len(part) for part in pictures.load(cfg)] == [1, 1, 1]


def test_pictures_that_are_too_small_are_refused_before_training(tmp_path):
    put(tmp_path / "pictures", sizes=[(60, 60)] * 12)
    given = (f"data.root={tmp_path / 'pictures'}", f"runs={tmp_path / 'runs'}")
    with pytest.raises(ValueError, match=r"no pictures to test on: .* Pass a smaller test.size=N"):
        demoireing.fit(configure(*given, "test.size=64"))
    assert not list(tmp_path.rglob("*.ckpt"))


def test_a_folder_that_has_changed_tests_no_run(tmp_path, monkeypatch):
    """The split is another: pictures that it was trained on could test it."""
    put(tmp_path / "pictures", sizes=[(64, 64)] * 23)
    cfg = configure(f"data.root={tmp_path / 'pictures'}")
    before = pictures.load(cfg).files
    assert before == pictures.load(cfg).files != pictures.load(configure()).files == ""
    first = tmp_path / "pictures/class0/0.png"
    Image.open(first).save(tmp_path / "pictures/another.png")
    monkeypatch.setattr(resume, "_checkpoints", lambda run: [{"files": before}])
    monkeypatch.setattr(demoireing_training, "try_out", lambda run: None)
    with pytest.raises(ValueError, match=r"files that it was trained on are not .* Restore them"):
        demoireing.complete(Run(cfg))
