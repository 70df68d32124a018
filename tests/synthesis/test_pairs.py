"""Pairs: each is a pure function of its number, replays from its numbers, and is aligned."""

import errno
import json
import os
import pickle

import numpy as np
import pytest
import torch
from PIL import Image
from torch.utils.data import DataLoader
from torchvision.datasets.folder import IMG_EXTENSIONS

from moireaug import Develop, Lens, Panel, Scene, Sensor, Shot, View, capture
from moireaug.scene.by_name import with_values
from moireaug.synthesis import Pairs, pictures, without_moire
from tests.synthesis.folders import put, spoil
from training.data.real_pairs import find_images

SIZE = 32


@pytest.fixture
def folder(tmp_path):
    return put(tmp_path / "pictures")


def same(one, other):
    """Whether two pairs have the same pictures and numbers."""
    ours, theirs = one.pictures(), other.pictures()
    alike = one.to_dict() == other.to_dict() and ours.keys() == theirs.keys()
    return alike and all(torch.equal(picture, theirs[name]) for name, picture in ours.items())


@pytest.mark.parametrize("scene", ["phone_at_monitor", ["dashcam_at_led_sign", "screen_photo"]])
def test_a_pair_replays_from_its_numbers(folder, scene):
    pairs = Pairs(folder, scene, SIZE, twin=True)
    for k in (0, 7):
        pair = pairs.make_pair(k)
        numbers = json.loads(json.dumps(pair.to_dict()))
        with Image.open(folder / numbers["picture"]) as picture:
            whole = np.array(picture)
        top, left = numbers["top"], numbers["left"]
        crop = torch.from_numpy(whole[top : top + SIZE, left : left + SIZE]).permute(2, 0, 1)
        assert torch.equal(pair.original, crop) and pair.original.dtype == torch.uint8
        shot = Shot.from_dict(numbers["shot"])
        shown = crop[None].float() / 255
        for taken, by in ((pair.photo, shot), (pair.twin, without_moire(shot))):
            assert torch.equal(taken, (capture(shown, by)[0] * 255).round().to(torch.uint8))


def test_the_moire_of_a_pair_is_the_distance_of_its_twin(folder):
    mean_light = with_values(Scene.preset("screen_photo"), {"sensor.exposure": "mean"})
    pair = Pairs(folder, mean_light, SIZE, twin=True).make_pair(0)
    assert pair.moire == pair.to_dict()["moire"] == 0
    pair = Pairs(folder, "screen_photo", SIZE, twin=True, shrink=(1, 3)).make_pair(0)
    error = pair.photo.numpy().astype(float) - pair.twin.numpy()
    assert pair.moire == pytest.approx(np.sqrt((error**2).mean()), rel=1e-5) and pair.moire > 1
    alone = Pairs(folder, "screen_photo", SIZE).make_pair(0)
    assert alone.moire is None and "moire" not in alone.to_dict()


def test_what_is_no_number_of_a_pair_is_refused(folder):
    pairs = Pairs(folder, "screen_photo", 32)
    for k in (-1, 1.5, "1", True, 2**63):
        error = ValueError if k in (-1, 2**63) else TypeError
        with pytest.raises(error, match=r"k must be a whole number from 0 to \d+; got"):
            pairs.make_pair(k)


def test_a_pair_depends_on_its_number_alone(folder):
    spoil(folder)
    forwards, backwards = (Pairs(folder, "screen_photo", SIZE, twin=True) for _ in range(2))
    made = [forwards.make_pair(k) for k in range(8)]
    for pair in reversed(made):
        assert same(pair, backwards.make_pair(pair.index))
    other = Pairs(folder, "screen_photo", SIZE, twin=True, seed=1)
    assert not any(same(pair, other.make_pair(pair.index)) for pair in made)
    drawn = {(p.picture, p.top, p.left, p.shot.view.yaw.item()) for p in made}
    assert len(drawn) == 8, "draws repeat"


def test_the_twin_has_the_noise_and_not_the_moire(tmp_path):
    Image.new("RGB", (64, 64), (128, 128, 128)).save(tmp_path / "grey.png")
    panel, view, lens = Panel(scale=1.2), View(roll=(5, 10)), Lens(blur=0.3)
    quiet = Scene(panel=panel, view=view, lens=lens, sensor=Sensor(scale=2, gain=2.5))
    pair = Pairs(tmp_path, quiet, 64, twin=True).make_pair(0)
    inside = (slice(None), slice(8, 56), slice(8, 56))
    moire, none = (p[inside].float().std((1, 2)).max() for p in (pair.photo, pair.twin))
    assert none < 0.5 < 4 < moire
    noisy = Scene(sensor=Sensor(scale=2, gain=2.5, exposure="mean", read_noise=0.02))
    pair = Pairs(tmp_path, noisy, 64, twin=True).make_pair(0)
    assert torch.equal(pair.photo, pair.twin) and pair.twin[inside].float().std() > 1


def test_the_pictures_of_a_pair_are_aligned(tmp_path):
    put(tmp_path, sizes=[(64, 64)])
    for k in range(3):
        pair = Pairs(tmp_path, "phone_at_monitor", 64, twin=True).make_pair(k)
        original = pair.original[:, 8:-8, 8:-8].float()
        error = {}
        for dy in (-1, 0, 1):
            for dx in (-1, 0, 1):
                moved = pair.twin.roll((dy, dx), (1, 2))[:, 8:-8, 8:-8].float()
                error[dy, dx] = torch.corrcoef(torch.stack([moved.ravel(), original.ravel()]))[0, 1]
        assert max(error, key=error.get) == (0, 0)


def test_unusable_pictures_are_named_and_others_drawn_in_their_place(folder):
    spoil(folder)
    pairs = Pairs(folder, "screen_photo", SIZE)
    assert pairs.pictures.others == ["notes.txt"]
    names = [pairs.pictures.draw(np.random.default_rng(k))[0] for k in range(300)]
    counts = {name: names.count(name) for name in set(names)}
    assert counts.keys() == {"class0/0.png", "class1/1.png", "class0/2.png"}
    assert min(counts.values()) > 70, "each is as likely, the next after a torn one too"
    reasons = " ".join(pairs.pictures.unusable.values())
    assert len(pairs.pictures.unusable) == 3
    assert "torn.png could not be read" in reasons and "words.jpg could not be read" in reasons
    assert "low.png is too small: 200 x 20 pixels, and the crops have 32 x 32" in reasons


def test_pictures_are_the_files_that_an_image_folder_takes():
    assert set(pictures.SUFFIXES) == {*IMG_EXTENSIONS, ".jfif"}  # JPEGs, too


def test_where_no_picture_is_usable_it_is_said(tmp_path):
    spoil(put(tmp_path))
    for path in tmp_path.glob("class*/*.png"):
        path.unlink()
    pairs = Pairs(tmp_path, "screen_photo", SIZE)
    with pytest.raises(ValueError, match=r"none of the 3 pictures in .* is usable\. The first:"):
        pairs.make_pair(0)


@pytest.mark.parametrize("find", [lambda folder: pictures.Pictures(folder, 1), find_images])
def test_an_unreadable_folder_is_not_passed_over(folder, monkeypatch, find):
    scan, closed = os.scandir, str(folder / "class1")

    def refuse(path):
        if str(path) == closed:
            raise PermissionError(13, "Permission denied", closed)
        return scan(path)

    monkeypatch.setattr(os, "scandir", refuse)
    with pytest.raises(ValueError, match=r"class1 could not be read \(Permission denied\)"):
        find(folder)


def test_a_failing_disk_is_no_reason_to_take_another_picture(folder, monkeypatch):
    def fail(path):
        raise ValueError(f"The image {path} could not be read.") from OSError(errno.EIO, "")

    monkeypatch.setattr(pictures, "read_picture", fail)
    pairs = Pairs(folder, "screen_photo", SIZE)
    with pytest.raises(ValueError, match="could not be read"):
        pairs.make_pair(0)
    assert not pairs.pictures.unusable


def test_the_fingerprint_knows_names_and_sizes(folder):
    def mark():
        return Pairs(folder, "screen_photo", SIZE).pictures.fingerprint()

    before = mark()
    (folder / "notes.txt").touch()
    assert mark() == before
    path = folder / "class0/0.png"
    path.rename(folder / "class0/renamed.png")
    renamed = mark()
    (folder / "class0/renamed.png").write_bytes(b"other")
    assert len({before, renamed, mark()}) == 3


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")  # Python 3.12 and newer
def test_workers_share_the_pairs_out_unchanged(folder):
    pairs = Pairs(folder, "phone_at_monitor", SIZE, twin=True, n=7)
    loader = DataLoader(pairs, batch_size=2, num_workers=2, multiprocessing_context="fork")
    found = {}
    for batch in loader:
        for row, k in enumerate(batch["index"].tolist()):
            assert k not in found
            found[k] = {name: batch[name][row] for name in ("photo", "original", "twin")}
    assert sorted(found) == list(range(7))
    for k, item in found.items():
        for name, picture in pairs.make_pair(k).pictures().items():
            assert item[name].dtype == torch.float32
            assert torch.equal(item[name], picture.float() / 255)


def test_ranks_share_the_pairs_out(folder, monkeypatch):
    monkeypatch.setattr(torch.distributed, "is_initialized", lambda: True)
    monkeypatch.setattr(torch.distributed, "get_world_size", lambda: 3)
    found = []
    for rank in range(3):
        monkeypatch.setattr(torch.distributed, "get_rank", lambda rank=rank: rank)
        found += [item["index"] for item in Pairs(folder, "screen_photo", SIZE, n=8)]
    assert sorted(found) == list(range(8)) and found != sorted(found)


def test_spawned_workers_of_ranks_share_the_pairs_out(folder, monkeypatch):
    pairs, sent, found = Pairs(folder, "screen_photo", SIZE, n=3), [], []
    for rank in range(2):
        with monkeypatch.context() as patch:
            patch.setattr(torch.distributed, "is_initialized", lambda: True)
            patch.setattr(torch.distributed, "get_world_size", lambda: 2)
            patch.setattr(torch.distributed, "get_rank", lambda rank=rank: rank)
            sent.append(pickle.dumps(pairs))
    for content in sent:  # where torch.distributed does not run
        found += [item["index"] for item in pickle.loads(content)]
    assert found == [0, 2, 1]


def test_without_n_there_is_no_end(folder):
    items = iter(Pairs(folder, "screen_photo", np.int64(SIZE)))
    item = next(items)
    assert item.keys() == {"index", "photo", "original"}
    assert [next(items)["index"] for _ in range(3)] == [1, 2, 3]


REFUSED = [
    ({"scene": "paper"}, "leaves its photos in the camera's frame"),
    ({"scene": Scene(develop=Develop(registered=False))}, "Develop\\(registered=True\\)"),
    ({"scene": ["phone_at_monitor", "paper"]}, "leaves its photos in the camera's frame"),
    ({"scene": "phone_at_monitr"}, "Did you mean 'phone_at_monitor'"),
    ({"size": 15}, "size must be a whole number from 16 to 8192; got 15"),
    ({"size": 32.0}, "size must be a whole number"),
    ({"seed": -1}, "seed must be a whole number"),
    ({"n": True}, "n must be a whole number"),
    ({"n": 0}, "n must be a whole number of at least 1; got 0"),
    ({"frames": 1}, "frames must be a whole number of at least 2; got 1"),
    ({"images": "nowhere"}, "nowhere is not a folder"),
    ({"images": "empty"}, "holds no pictures: none of its 1 files ends with .jpg"),
]


def test_what_cannot_be_followed_is_refused(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty/notes.txt").touch()
    for given, said in REFUSED:
        with pytest.raises((TypeError, ValueError), match=said):
            Pairs(**{"images": folder, "scene": "screen_photo", "size": SIZE} | given)


def test_each_pair_is_in_one_of_the_listed_scenes(folder):
    names = ["phone_at_monitor", "dashcam_at_led_sign"]
    pairs, again = Pairs(folder, names, SIZE, twin=True), Pairs(folder, names, SIZE, twin=True)
    found = [pairs.make_pair(k) for k in range(8)]
    assert {pair.shot.scene for pair in found} == {Scene.preset(name) for name in names}
    assert same(found[7], again.make_pair(7))
    one = Pairs(folder, names[:1], SIZE, twin=True)
    assert same(one.make_pair(3), Pairs(folder, names[0], SIZE, twin=True).make_pair(3))


def test_a_video_begins_with_the_photo_and_replays(folder):
    scene = Scene.preset("screen_photo").with_shrink(1.0)
    filmed = Pairs(folder, scene, SIZE, twin=True, frames=3)
    video, photo = filmed.make_pair(5), Pairs(folder, scene, SIZE, twin=True).make_pair(5)
    assert video.photo.shape == video.twin.shape == (3, 3, SIZE, SIZE)
    assert torch.equal(video.original, photo.original)
    assert (video.photo[0].float() - photo.photo.float()).abs().max() <= 2  # of one more plan
    shot = Shot.from_dict(json.loads(json.dumps(video.to_dict()["shot"])))
    again = capture(video.original[None].expand(3, -1, -1, -1) / 255, shot)
    assert torch.equal(video.photo, (again * 255).round().to(torch.uint8))
    assert not torch.equal(video.photo[1], video.photo[0]) and video.moire > 0
    item = next(iter(filmed))
    assert item["photo"].shape == (3, 3, SIZE, SIZE) and item["original"].shape == (3, SIZE, SIZE)
