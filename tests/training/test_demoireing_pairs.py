"""A demoiréing network's pairs, and which pictures train, validate and test it."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

from moireaug import Scene
from moireaug.synthesis.pictures import Pictures
from tests.synthesis.folders import put
from tests.training.test_demoireing import configure
from training.data import drawn_pictures
from training.data.codes import codes_of, picture_of, through_jpeg
from training.demoireing import fit as demoireing
from training.demoireing import pairs as demoireing_pairs
from training.demoireing import pictures
from training.demoireing import train as demoireing_training
from training.demoireing.pairs import (
    SimulatedPairs,
    TurnedPairs,
    enlarge_scene,
    shrink,
    training_scenes,
)
from training.demoireing.pictures import DrawnPictures, Splits
from training.runs import resume

pytestmark = pytest.mark.usefixtures("as_the_command_is")


def excess(pairs, count=4):
    """Return the mean distance between photos and their targets, in codes."""
    distances = []
    for k in range(count):
        photo, target = pairs[k]
        distances.append((photo.float() - target.float()).square().mean().sqrt())
    return float(torch.stack(distances).mean())


def test_pairs_are_crops_by_default_and_have_more_moire_than_whole_photos():
    cfg = configure()
    (strong,) = list(training_scenes(replace(cfg, scene="phone_at_monitor")).values())
    assert strong == Scene.preset("phone_at_monitor").with_shrink((1, 3))
    whole = replace(cfg, scene="phone_at_monitor", shrink=None)
    (faint,) = list(training_scenes(whole).values())
    assert faint == Scene.preset("phone_at_monitor")
    excesses = [
        excess(SimulatedPairs(DrawnPictures(64), [scene], 64, "clean", 0))
        for scene in (faint, strong)
    ]
    assert excesses[1] > 1.3 * excesses[0]
    tested = demoireing_pairs.test_pairs(cfg, Splits(*[DrawnPictures(64)] * 3))
    assert all(pairs.scenes[0][0].sensor.shrink == (1.0, 3.0) for pairs in tested.values())


def test_a_picture_of_more_pixels_shows_the_same_part_of_the_screen():
    crop, thing = (
        Scene.preset(name).with_shrink((1, 3))
        for name in ("phone_at_monitor", "dashcam_at_led_sign")
    )
    for scene in (crop, thing):
        large = enlarge_scene(scene, 2)
        shots = [
            one.sample(4, size, torch.Generator().manual_seed(0))
            for one, size in ((scene, (32, 32)), (large, (64, 64)))
        ]
        assert torch.allclose(shots[0].panel_scale, 2 * shots[1].panel_scale)
        assert torch.allclose(shots[0].sensor_scale, 2 * shots[1].sensor_scale)
    assert enlarge_scene(Scene.preset("phone_at_monitor"), 3) == Scene.preset("phone_at_monitor")


def test_a_clean_target_has_no_noise_and_a_twin_has():
    scene = Scene.preset("webcam_at_phone").with_shrink((1, 3))
    scene = replace(scene, sensor=replace(scene.sensor, exposure="mean"))
    noisy, clean = (
        SimulatedPairs(DrawnPictures(32), [scene], 32, target, 0) for target in ("twin", "clean")
    )
    assert excess(noisy) == 0 and excess(clean) > 1


def test_shrunk_photos_alias_and_their_targets_do_not():
    stripes = torch.tensor([0, 255, 0], dtype=torch.uint8).repeat(3, 33, 11)
    photo, target = (shrink(stripes, 3, antialias=one).float() for one in (False, True))
    assert photo.shape == target.shape == (3, 11, 11)
    assert photo.min() == 255  # the filterless one hits the middle of each stripe
    assert target[..., 1:-1].max() < 130
    assert shrink(stripes, 1, antialias=False) is stripes


def test_photos_are_saved_as_jpeg_and_targets_are_not():
    scene = Scene.preset("screen_photo").with_shrink((1, 3))
    plain, rough = (
        SimulatedPairs(DrawnPictures(32), [scene], 32, "clean", 0, jpeg=jpeg)[0]
        for jpeg in (None, 1)
    )
    assert torch.equal(plain[1], rough[1]) and not torch.equal(plain[0], rough[0])
    noise = torch.randint(0, 256, (1, 32, 32), dtype=torch.uint8).repeat(3, 1, 1)
    files = (through_jpeg(picture_of(noise), quality) for quality in (20, 98))
    worse, better = (codes_of(file).float() - noise for file in files)
    assert better.abs().mean() < 3 < 10 < worse.abs().mean()


def test_kept_pairs_come_again_turned_and_mirrored():
    scene = Scene.preset("screen_photo").with_shrink((1, 3))
    pairs = SimulatedPairs(DrawnPictures(32), [scene], 32, "clean", 0, subsample=2)
    kept = TurnedPairs(pairs, 2)
    assert {tuple(side.shape) for k in range(4) for side in kept[k]} == {(3, 32, 32)}
    for k in (0, 1):
        assert all(map(torch.equal, kept[k], pairs[k]))
        mirrored = [side.rot90(1, (1, 2)).flip(2) for side in pairs[k]]
        assert all(map(torch.equal, kept[k + 2 * 5], mirrored))


def test_of_several_candidates_the_one_with_the_strongest_coarse_colour_is_kept():
    candidates = []
    for strength in (0, 40, 60, 20, 90, 30):
        photo = torch.full((3, 32, 32), 100, dtype=torch.uint8)
        photo[0, :16] += strength
        photo[:, :, ::2] += 5 * (6 - len(candidates))  # fine, and of no colour
        candidates.append((photo, torch.full_like(photo, 100)))
    kept = TurnedPairs(candidates, 2, 3)
    assert torch.equal(kept[0][0], candidates[4][0])
    assert torch.equal(kept[1][0], candidates[1][0])


def test_every_kind_of_drawn_picture_is_a_function_of_its_generator():
    for draw, _ in drawn_pictures.KINDS.values():
        first, again, other = (draw(np.random.default_rng(seed), 32) for seed in (0, 0, 1))
        assert (first.mode, first.size) == ("RGB", (32, 32))
        assert np.array_equal(first, again) and not np.array_equal(first, other)
        assert np.asarray(first).std() > 2


def test_drawn_pictures_are_of_every_kind():
    rng = np.random.default_rng(0)
    kinds = {drawn_pictures.render(rng, 16)[0] for _ in range(40)}
    assert kinds == set(drawn_pictures.KINDS)


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
        demoireing.fit(cfg)
