"""A folder of images as data, and the order in which training reads it."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from PIL import Image
from torch.utils.data import TensorDataset
from torchvision import datasets

from tests.training.small import configured
from training import fit
from training.config.checks import require_training_images
from training.config.data_sets import DATA_SETS, Data, torchvision_set
from training.data import signs
from training.data.batches import Batches
from training.data.load import load
from training.system.files import locked

ROOT = Path(__file__).resolve().parents[2]


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


def test_a_folder_of_test_images_alone_is_not_trained_on(root):
    with pytest.raises(ValueError, match=r"lacks train/ or test/.* use training/reattack\.py"):
        require_training_images(Data(name="folder", root=str(root / "test")))
    require_training_images(Data(name="folder", root=str(root)))


def test_train_may_be_a_class(root):
    (root / "test/n02").rename(root / "test/train")
    alone = load(Data(name="folder", root=str(root / "test"), size=16))
    assert alone.classes == {0: "n03", 1: "train"}


def test_hidden_files_and_folders_are_left_out(root):
    for name in (".ipynb_checkpoints/a.png", "n02/.thumbs/a.png", "n02/._0.png"):
        (root / "test" / name).parent.mkdir(exist_ok=True)
        (root / "test" / name).write_text("no picture")
    splits = load(Data(name="folder", root=str(root / "test"), size=16))
    assert splits.classes == {0: "n02", 1: "n03"} and len(splits.test) == 6
    assert [label for _, label in splits.test] == [0] * 3 + [1] * 3


def test_names_need_not_be_utf_8(root):
    """Of data sets, classes and files; the names alone change the fingerprint."""
    for half in ("train", "test"):
        (root / half / "n02").rename(root / half / "n\udcff")
        for other in ("n01", "n03"):
            if (root / half / other).exists():
                (root / half / other).rename(root / half / "n\nline")
    odd = root.rename(root.with_name("root\udcfe"))
    splits = folder(odd)
    assert splits.classes == {0: "n\nline", 1: "n\udcff"} and splits.train[0][0].shape[0] == 3
    (odd / "train/n\udcff/0.png").rename(odd / "train/n\udcff/\udcfd.png")
    assert folder(odd).files != splits.files


def test_a_picture_is_of_one_class(root):
    """Whatever links lead to the others; a class without pictures is named."""
    alone = Data(name="folder", root=str(root / "test"), size=16)
    (root / "test/n02/0.png").rename(root / "test/n02/0.JFIF")
    assert len(load(alone).test) == 6
    (root / "test/n02/up").symlink_to("..")
    with pytest.raises(ValueError, match=r"in two classes, 'n02' and 'n03', by a link: remove it"):
        load(alone)
    (root / "test/n02/up").unlink()
    (root / "test/n04").mkdir()
    with pytest.raises(ValueError, match=r"n04 holds no pictures \(\.jpg, .*\): add some, or r"):
        load(alone)


def test_a_failed_download_is_not_told_to_download(tmp_path, monkeypatch):
    def make(*args, **settings):
        raise OSError("Network is unreachable")

    monkeypatch.setattr(datasets, "CIFAR10", make)
    cfg = Data(name="cifar10", root=str(tmp_path), download=True)
    with pytest.raises(ValueError, match=r"could not be fetched into .*Check the network") as error:
        load(cfg)
    assert "data.download=true" not in str(error.value)


def test_one_process_at_a_time_downloads(tmp_path, monkeypatch):
    def make(folder, transform, download, train):
        with (
            pytest.raises(ValueError, match="busy"),
            locked(Path(folder, ".download.lock"), "busy"),
        ):
            pass
        return [(torch.zeros(3, 4, 4, dtype=torch.uint8), 0)] * 4

    monkeypatch.setattr(datasets, "CIFAR10", make)
    described = torchvision_set("CIFAR10", {"train": True}, {"train": False}, "shift_flip", 10)
    monkeypatch.setitem(DATA_SETS, "cifar10", described)
    cfg = Data(name="cifar10", root=str(tmp_path / "new"), size=16, val=1, download=True)
    assert len(load(cfg).train) == 3


def test_a_new_set_of_torchvision_is_a_row():
    """In a process of its own, as the settings are declared when they are imported."""
    code = """
import pathlib, sys, types
from torchvision import datasets
row = '"new": torchvision_set("FakeData", {"size": 9}, {"size": 5}, "shift", 10),'
text = pathlib.Path("training/config/data_sets.py").read_text("utf-8")
sets = types.ModuleType("training.config.data_sets")
sys.modules[sets.__name__] = sets
exec(text.replace("DATA_SETS = {", "DATA_SETS = {" + row, 1), sets.__dict__)
make = datasets.FakeData
datasets.FakeData = lambda root, size, transform, download: make(size, transform=transform)
from tests.training.small import configured
from training.recipe.phases import ClassificationTask
from training.data.load import load
cfg = configured("recipe=clean", "data=new")
ClassificationTask().check(cfg)
splits = load(cfg.data)
print(cfg.data.augment, len(splits.train), len(splits.test), splits.num_classes)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout.split() == ["shift", "8", "5", "10"], done.stderr


def grey_set(root, transform, download, **part):
    return [(transform(Image.new("L", (28, 28), 60)), k % 2) for k in range(4)]


@pytest.mark.parametrize("num_classes", [2, 0])
def test_grey_images_become_colour_and_classes_must_be_known(num_classes, monkeypatch, tmp_path):
    monkeypatch.setattr(datasets, "Grey", grey_set, raising=False)
    row = torchvision_set("Grey", {"train": True}, {"train": False}, "shift", num_classes)
    monkeypatch.setitem(DATA_SETS, "grey", row)
    cfg = Data(name="grey", root=str(tmp_path), size=16, val=1)
    if num_classes:
        image, _ = load(cfg).train[0]
        assert image.shape == (3, 16, 16) and image.unique().tolist() == [60]
    else:
        with pytest.raises(ValueError, match=r"num_classes, in the row 'grey' of DATA_SETS"):
            load(cfg)


def test_a_single_class_is_refused(root, monkeypatch):
    monkeypatch.chdir(root)
    for half, name in (("train", "n01"), ("test", "n03")):
        shutil.rmtree(root / half / name)
    with pytest.raises(ValueError, match=r"hold a single class, 'n02'"):
        fit.fit(configured("recipe=clean", "data=folder", f"data.root={root}", "data.size=16"))


ROWS = {
    "n01,7\nn02,123\nn03,1000\n": r"class_index from 0 to 999 for the folders \['n03'\]",
    "n01,7\nn02,123\nn04,5\n": r"class_index from 0 to 999 for the folders \['n03'\]",
    "n01,7\nn02,123\nn03,-1\n": r"class_index from 0 to 999 for the folders \['n03'\]",
    "n01,7\nn02,7\nn03,9\n": r"gives the folders 'n01' and 'n02' of '.*' one class_index, 7",
    "n01,7\nn02,8\nn03,9\nn01,5\n": "n01 has two, 7 and 5",
    "n" * 140_000 + ",7\n": "could not be read .*field larger than field limit",
}


def test_a_folder_has_one_class_of_its_own(root):
    table = root / "labels.csv"
    for rows, said in ROWS.items():
        table.write_text("wnid,class_index\n" + rows)
        with pytest.raises(ValueError, match=said):
            folder(root, class_index=str(table))
    # a line that repeats another; and as Excel saves "CSV UTF-8"
    rows = "wnid,class_index\nn01,7\nn02,8\nn03,9\nn01,7\n"
    table.write_text(rows, encoding="utf-8-sig")
    assert folder(root, class_index=str(table)).num_classes == 1000


def test_signs_are_drawn_when_they_are_read(monkeypatch):
    drawn = []
    make = signs.make

    def recorded(split, *numbers):
        drawn.append(split)
        return make(split, *numbers)

    monkeypatch.setattr(signs, "make", recorded)
    splits = load(Data(name="signs", size=16, train=3, val=3, test=3))
    assert [len(splits.train), len(splits.val), len(splits.test)] == [3, 3, 3] and not drawn
    images, labels = make("test", 3, 16)
    for i in range(3):
        image, label = splits.test[i]
        assert torch.equal(image, images[i]) and label == labels[i]
    assert drawn == ["test"]


N = 60


def order(ranks, rank, epoch, seed=5):
    """The images that a rank's loader yields in an epoch."""
    data = TensorDataset(torch.arange(N), torch.arange(N))
    splits = type("Splits", (), {"train": data, "val": None})
    batches = Batches(splits, 8, workers=0, seed=seed)
    batches.trainer = type("Trainer", (), {"world_size": ranks, "global_rank": rank})
    loader = batches.train_dataloader()
    loader.sampler.set_epoch(epoch)
    return [image for images, _ in loader for image in images.tolist()]


def test_two_ranks_see_the_batches_of_one():
    alone, ranks = order(1, 0, epoch=1), [order(2, rank, epoch=1) for rank in range(2)]
    assert len(set(alone)) == len(alone) == N // 8 * 8
    for start in range(0, len(alone), 8):
        halves = [rank[start // 2 : start // 2 + 4] for rank in ranks]
        assert sorted(alone[start : start + 8]) == sorted(halves[0] + halves[1])


def test_the_order_follows_seed_and_epoch_alone():
    assert order(1, 0, epoch=1) == order(1, 0, epoch=1)
    assert order(1, 0, epoch=1) != order(1, 0, epoch=2)
    assert order(1, 0, epoch=1) != order(1, 0, epoch=1, seed=6)


@pytest.mark.parametrize(
    ("side", "ranks", "most"), [(32, 1, 320), (224, 1, 25), (4096, 1, 1), (448, 8, 1)]
)
def test_a_batch_of_validation_is_bounded_in_pixels(side, ranks, most):
    picture = torch.zeros(1, 1, 1, 1, dtype=torch.uint8).expand(400, 3, side, side)
    splits = type("Splits", (), {"val": TensorDataset(picture, torch.arange(400))})
    batches = Batches(splits, 8, workers=0, seed=0)
    batches.trainer = type("Trainer", (), {"world_size": ranks, "global_rank": 0})
    assert batches.val_dataloader().batch_size == most
