"""A demoiréing network's pairs: what a crop shows, shrunk photos, pairs that come again."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from moireaug import Scene
from training.data import drawn_pictures
from training.demoireing.pairs import SimulatedPairs, TurnedPairs, as_jpeg, part_of, shrink
from training.demoireing.pictures import DrawnPictures


def excess(pairs, count=8):
    """Return the mean distance between photos and their targets, in codes."""
    distances = []
    for k in range(count):
        photo, target = pairs[k]
        distances.append((photo.float() - target.float()).square().mean().sqrt())
    return float(torch.stack(distances).mean())


def test_a_crop_shows_its_share_of_the_panel():
    whole = Scene.preset("phone_at_monitor")
    part = part_of(whole, 0.128)
    assert part.panel.width == pytest.approx((51.2, 204.8))
    assert part_of(Scene.preset("paper"), 0.1) == Scene.preset("paper")
    faint, strong = (
        SimulatedPairs(DrawnPictures(64), [scene], 64, "clean", 0)
        for scene in (whole, part_of(whole, 0.064))
    )
    assert excess(strong) > 1.3 * excess(faint)


def test_a_clean_target_has_no_noise_and_a_twin_has():
    scene = part_of(Scene.preset("webcam_at_phone"), 0.05)
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
    scene = part_of(Scene.preset("screen_photo"), 0.05)
    plain, rough = (
        SimulatedPairs(DrawnPictures(32), [scene], 32, "clean", 0, jpeg=jpeg)[0]
        for jpeg in (None, 1)
    )
    assert torch.equal(plain[1], rough[1]) and not torch.equal(plain[0], rough[0])
    noise = torch.randint(0, 256, (1, 32, 32), dtype=torch.uint8).repeat(3, 1, 1)
    worse, better = (as_jpeg(noise, quality).float() - noise for quality in (20, 98))
    assert better.abs().mean() < 3 < 10 < worse.abs().mean()


def test_kept_pairs_come_again_turned_and_mirrored():
    scene = part_of(Scene.preset("screen_photo"), 0.05)
    pairs = SimulatedPairs(DrawnPictures(32), [scene], 32, "clean", 0, shrink=2)
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


@pytest.mark.parametrize("kind", drawn_pictures.KINDS)
def test_every_kind_of_drawn_picture_is_a_function_of_its_generator(kind):
    draw, _ = drawn_pictures.KINDS[kind]
    first, again, other = (draw(np.random.default_rng(seed), 64) for seed in (0, 0, 1))
    assert (first.mode, first.size) == ("RGB", (64, 64))
    assert np.array_equal(first, again) and not np.array_equal(first, other)
    assert np.asarray(first).std() > 2


def test_drawn_pictures_are_of_every_kind():
    rng = np.random.default_rng(0)
    kinds = {drawn_pictures.render(rng, 16)[0] for _ in range(100)}
    assert kinds == set(drawn_pictures.KINDS)
