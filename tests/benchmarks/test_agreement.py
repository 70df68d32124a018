"""How many answers of classifiers are kept: of networks whose answers for each photo are known."""

import dataclasses
import math

import pytest
import torch
import torch.nn.functional as F
from torch import nn

from benchmarks.agreement import (
    ORIGINALS,
    REAL_PHOTOS,
    SMALL_CHANGES,
    Kind,
    Sizes,
    agree,
    answers_kept,
    phi_coefficient,
)
from moireaug import Lens, Panel, Scene, Sensor
from training.data.real_pairs import ScreenPhoto

SIZES = Sizes(judged=48, shrunk=(32,))
SCREEN = Scene(panel=Panel(width=110.0), lens=Lens(blur=0.3), sensor=Sensor(pitch=2.1, gain=3.0))
DARK = dataclasses.replace(SCREEN, sensor=Sensor(pitch=2.1, gain=0.5))
FROM = ("its own size", "its own size, no moiré", "shrunk to 32 px")


class IsBright(nn.Module):
    """Answers 1 for pictures brighter than 0.4."""

    def forward(self, images):
        return torch.stack([torch.full((len(images),), 0.4), images.mean((1, 2, 3))], 1)


class IsStriped(nn.Module):
    """Answers 1 for pictures with detail of more than a hundredth."""

    def forward(self, images):
        detail = (images - F.avg_pool2d(images, 9, 1, 4, count_include_pad=False)).std((1, 2, 3))
        return torch.stack([torch.full((len(images),), 0.01), detail], 1)


def flat(code):
    return torch.full((3, 64, 80), code, dtype=torch.uint8)


def shown(*pairs):
    """Pairs of flat pictures, by the codes of photo and original."""
    return [
        ScreenPhoto(str(i), flat(photo), flat(original))
        for i, (photo, original) in enumerate(pairs)
    ]


def test_answers_are_those_for_the_simulated_photos():
    chosen = {"bright": SCREEN, "dark": DARK}
    found = answers_kept({"net": IsBright()}, shown((180, 180), (180, 180)), chosen, SIZES)
    assert found.pop(("net", REAL_PHOTOS)) == [True, True]
    for changed in ("shrunk to 32 px", *SMALL_CHANGES):
        assert found.pop(("net", Kind(ORIGINALS, changed))) == [True, True]
    assert found == {
        ("net", Kind(scene, shown)): [scene == "bright"] * 2 for scene in chosen for shown in FROM
    }


def test_moire_alone_changes_the_answers_of_a_stripe_detector():
    found = answers_kept({"net": IsStriped()}, shown((180, 180)), {"screen": SCREEN}, SIZES)
    kept = {kind: all(answers) for (_, kind), answers in found.items() if kind.scene != ORIGINALS}
    assert {kind.shown: is_kept for kind, is_kept in kept.items()} == {
        "a screen": True,
        "its own size": False,
        "its own size, no moiré": True,
        "shrunk to 32 px": False,
    }


def test_the_correlation_is_picture_by_picture():
    """Dark pictures stay dark in a dark scene; the real photos do the same, or the opposite."""
    for real, phi in (((60, 60, 60), 1.0), ((180, 180, 180), -1.0)):
        pairs = shown(*zip(real, (180, 180, 60), strict=True))
        rows = agree({"net": IsBright()}, pairs, {"dark": DARK}, SIZES)
        assert rows[0]["scene"] == REAL_PHOTOS.scene and rows[0]["phi"] is None
        for row in rows[1:4]:
            assert row["scene"] == ORIGINALS and row["kept"] == 3 and row["phi"] is None
        assert [(row["kept"], row["pictures"]) for row in rows[4:]] == [(1, 3)] * 3
        assert [row["phi"] for row in rows[4:]] == [pytest.approx(phi)] * 3


def test_small_changes_are_small_and_change_a_picture():
    picture = torch.rand(1, 3, 48, 48, generator=torch.Generator().manual_seed(0))
    moved, blurred = (change(picture) for change in SMALL_CHANGES.values())
    assert torch.equal(moved[..., 2:, 2:], picture[..., :-2, :-2])
    assert blurred.std() < 0.7 * picture.std()
    assert (blurred.mean() - picture.mean()).abs() < 0.01


def test_phi_is_that_of_a_table_of_four_counts():
    ours = [True] * 5 + [False] * 5
    theirs = [True] * 4 + [False] * 4 + [True] * 2
    both, ours_alone, theirs_alone, neither = 4, 1, 2, 3
    expected = (both * neither - ours_alone * theirs_alone) / math.sqrt(5 * 5 * 6 * 4)
    assert phi_coefficient(ours, theirs) == pytest.approx(expected)
    assert phi_coefficient(ours, [True] * 10) is None
