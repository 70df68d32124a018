"""A folder of images as data: halves with classes of their own, and sentences for what does not
fit."""

import shutil

import pytest
from PIL import Image

from tests.training.small import configured
from training import fit
from training.data import load, require_training_images
from training.schema import Data


@pytest.fixture
def root(tmp_path):
    for half, names in {"train": ("n01", "n02"), "test": ("n02", "n03")}.items():
        for k, name in enumerate(names):
            (tmp_path / half / name).mkdir(parents=True)
            for i in range(3):
                Image.new("RGB", (30, 20), (60 * k + i,) * 3).save(
                    tmp_path / half / name / f"{i}.png"
                )
    (tmp_path / "labels.csv").write_text("wnid,class_index\nn01,7\nn02,123\nn03,999\n")
    return tmp_path


def folder(root, **settings):
    return load(Data(name="folder", root=str(root), size=16, val=2, **settings))


def test_an_index_lets_the_halves_hold_different_classes(root):
    splits = folder(root, class_index=str(root / "labels.csv"))
    assert {y for _, y in splits.train} | {y for _, y in splits.val} == {7, 123}
    assert {y for _, y in splits.test} == {123, 999}
    assert splits.classes == {7: "n01", 123: "n02", 999: "n03"} and splits.num_classes == 1000


def test_without_an_index_the_halves_hold_the_same(root):
    with pytest.raises(ValueError, match=r"same class folders; these differ: \['n01', 'n03'\]"):
        folder(root)


def test_a_table_may_begin_as_excels_do(root):
    table = (root / "labels.csv").read_text()
    (root / "labels.csv").write_text(table, encoding="utf-8-sig")
    assert folder(root, class_index=str(root / "labels.csv")).num_classes == 1000


def test_a_folder_of_test_images_alone_is_not_trained_on(root):
    with pytest.raises(ValueError, match=r"has no folder train/.* use training/reattack\.py"):
        require_training_images(Data(name="folder", root=str(root / "test")))
    require_training_images(Data(name="folder", root=str(root)))


def test_a_single_class_is_refused(root, monkeypatch):
    monkeypatch.chdir(root)
    for half, name in (("train", "n01"), ("test", "n03")):
        shutil.rmtree(root / half / name)
    with pytest.raises(ValueError, match=r"hold a single class, 'n02'"):
        fit.fit(configured("recipe=clean", "data=folder", f"data.root={root}", "data.size=16"))


@pytest.mark.parametrize("row", ["n03,1000", "n04,5"])
def test_a_folder_without_a_class_gets_a_sentence(root, row):
    (root / "labels.csv").write_text(f"wnid,class_index\nn01,7\nn02,123\n{row}\n")
    with pytest.raises(
        ValueError, match=r"names no class_index below 1000 for the folders \['n03'\]"
    ):
        folder(root, class_index=str(root / "labels.csv"))
