"""Augmentations are compared on corruptions that change images as published, and on photos."""

import math
import sys

import numpy as np
import pandas as pd
import pytest
import torch
from PIL import Image

from benchmarks import augmentations, common_corruptions, corruptions
from benchmarks.common_corruptions import CORRUPTIONS, corrupt

AMOUNTS = {f: a for group in CORRUPTIONS.values() for f, a in group.items()}
FUNCTIONS = [f for f in AMOUNTS if f.__name__ != "frost"]  # whose photos are another package's


@pytest.fixture
def images():
    """Smooth colour pictures, (8, 3, 32, 32) uint8."""
    generator = torch.Generator().manual_seed(0)
    noise = torch.rand(8, 3, 32, 32, generator=generator)
    return (255 * (common_corruptions.blur(noise, 2) - 0.3) * 2.5).clamp(0, 255).byte()


@pytest.mark.parametrize("change", FUNCTIONS, ids=lambda f: f.__name__)
def test_corruptions_repeat_for_a_seed_and_grow_with_severity(change, images):
    first, again, other = (corrupt(images, change, AMOUNTS[change][4], seed) for seed in (0, 0, 1))
    assert first.shape == images.shape and first.dtype == torch.uint8
    assert torch.equal(first, again)
    draws = change.__name__ not in {
        *("defocus_blur", "zoom_blur", "brightness", "contrast", "pixelate", "jpeg")
    }
    assert torch.equal(first, other) is not draws
    if change.__name__ not in ("elastic", "glass_blur"):  # the published amounts of these fall
        mild = corrupt(images, change, AMOUNTS[change][0]).float()
        errors = [(one.float() - images).square().mean() for one in (mild, first)]
        assert 0 < errors[0] < errors[1]


def test_corruptions_have_their_amounts():
    grey = torch.full((4, 3, 64, 64), 0.5)
    torch.manual_seed(0)
    noise = common_corruptions.gaussian_noise(grey, 0.08) - grey
    assert noise.std().item() == pytest.approx(0.08, rel=0.02)
    shot = common_corruptions.shot_noise(grey, 50) - grey
    assert shot.std().item() == pytest.approx(math.sqrt(0.5 / 50), rel=0.02)
    share = (common_corruptions.impulse_noise(grey, 0.07) != grey).float().mean().item()
    assert share == pytest.approx(0.07, rel=0.05)
    assert common_corruptions.plasma(2, 32, 2).aminmax() == (0, 1)

    colour = torch.tensor([0.2, 0.4, 0.1])[None, :, None, None].expand(1, 3, 8, 8)
    brighter = common_corruptions.brightness(colour, 0.2)[0, :, 0, 0]
    assert brighter.tolist() == pytest.approx([0.3, 0.6, 0.15])
    assert common_corruptions.contrast(colour, 0.4) == pytest.approx(colour)


def test_blurs_keep_light_and_move_it_as_they_say():
    point = torch.zeros(2, 1, 33, 33)
    point[:, :, 16, 16] = 1
    angles = torch.tensor([0.0, torch.pi / 2])
    along_x, along_y = common_corruptions.motion(point, 6, 2.0, angles)
    assert torch.equal(along_x, along_y.mT)
    assert along_x.sum().item() == pytest.approx(1) and along_x[0, 16].sum().item() == along_x.sum()
    row = along_x[0, 16]
    assert (row[15] / row[16]).item() == pytest.approx(math.exp(-1 / 8))
    for blurred in (
        common_corruptions.defocus_blur(point, 1.5, 0.1),
        common_corruptions.blur(point, 1),
        common_corruptions.zoomed(torch.ones_like(point), 1.25) / 33**2,
    ):
        assert blurred[0].sum().item() == pytest.approx(1, abs=1e-5)


def test_augmentations_change_half_or_all_of_a_batch_and_stay_in_bounds():
    torch.manual_seed(0)
    images = torch.rand(16, 3, 32, 32)
    changed = {}
    for name, change in augmentations.augmentations().items():
        out = change(images)
        assert out.shape == images.shape and out.min() >= 0 and out.max() <= 1
        changed[name] = int(((out - images).abs().amax((1, 2, 3)) > 0.02).sum())
    assert changed["crop and flip"] == 0
    assert 3 <= changed["RandomMoire"] <= 13 and 3 <= changed["RandomMoire without moiré"] <= 13
    assert changed["AugMix, RandomMoire"] > 10 and changed["MoireMix"] > 5


def test_sines_are_circles_of_full_contrast():
    waves = augmentations.circular_sines(20, 32, 32)
    assert waves.shape == (20, 1, 32, 32)
    assert (waves.amin((1, 2, 3)) == 0).all() and (waves.amax((1, 2, 3)) == 1).all()


def test_the_script_trains_judges_and_resumes(tmp_path, monkeypatch, capsys):
    draw = np.random.default_rng(0)
    for part, n in (("train", 20), ("test", 10)):
        for kind, mean in (("dark", 60), ("light", 190)):
            (tmp_path / part / kind).mkdir(parents=True)
            for k in range(n):
                codes = draw.integers(mean - 50, mean + 50, (32, 32, 3), dtype=np.uint8)
                Image.fromarray(codes).save(tmp_path / part / kind / f"{k}.png")
    monkeypatch.setattr(corruptions, "MIXTURES", {"anywhere": ("screen_photo", "phone_at_phone")})
    monkeypatch.setattr(
        sys, "argv", ["corruptions.py", str(tmp_path), "--quick", "--out", str(tmp_path)]
    )
    corruptions.main()
    table = pd.read_csv(tmp_path / "corruptions.csv")
    assert table["augmentation"].nunique() == len(augmentations.augmentations())
    assert table["accuracy"].between(0, 1).all() and (table["train_seconds"] > 0).all()
    one = table[table["augmentation"] == "AugMix"].set_index(["kind", "name"])["answers"]
    assert len(one) == 1 + len(FUNCTIONS) + bool(common_corruptions.frost_photos()) + 2 + 1
    assert one["clean"].item() == 20 and set(one["blur"]) == {20}
    assert one["crops of photos"].index.tolist() == ["phone_at_phone"]
    assert "corrupted" in capsys.readouterr().out

    monkeypatch.setattr(corruptions, "train", None)  # all trainings are there
    corruptions.main()
    pd.testing.assert_frame_equal(table, pd.read_csv(tmp_path / "corruptions.csv"))
