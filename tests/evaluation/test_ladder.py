"""The ladder: its rows show and count what they say, and two models meet the same photos."""

import dataclasses

import numpy as np
import pytest
import torch

from moireaug import Scene, capture
from moireaug.evaluation import SuiteConfig, rates
from moireaug.evaluation.conditions import Photo, PhotoWithoutMoire
from moireaug.evaluation.suites.ladder import ladder
from moireaug.evaluation.tables import Cell, Table
from moireaug.scene.by_name import with_values
from moireaug.scene.presets import PRESETS
from moireaug.synthesis import without_moire

from .haze import frame_of

SCENE = Scene.preset("screen_photo")


def climbed(model, batches, eps=(4 / 255, 64 / 255), steps=4, only=None, seed=0):
    """Rates by row."""
    table = ladder(SuiteConfig(scene=SCENE, eps=eps, steps=steps))
    if only:
        table = Table("ladder", tuple(cell for cell in table.cells if cell.row in only))
    lines = rates(frame_of((model, batches), table, seed=seed))
    return {line["row"]: line for line in lines.to_dict("records")}


@pytest.fixture(scope="module")
def rows(known):
    return climbed(*known)


def test_rows_count_what_they_say(rows):
    controls = ["clean", "dimmed", "no_moire", "moire", "random_64"]
    assert list(rows) == [*controls, "ma_4", "ma_64", "ma_64_targeted", "pgd_64", "worst_64"]
    assert rows["clean"]["accuracy"] == 1.0 and rows["clean"]["success"] == 0.0
    for row in rows.values():
        assert row["n"] == 16 and row["counted"] == 16 and len(row["outcomes"]) == 16
        assert 0 <= row["accuracy_low"] <= row["accuracy"] <= row["accuracy_high"] <= 1
        assert row["outcomes"].count("1") == 16 * row["accuracy"]
        if not row["targeted"]:
            assert row["success"] == pytest.approx(1 - row["accuracy"])
    accuracy = {name: row["accuracy"] for name, row in rows.items()}
    assert accuracy["worst_64"] <= accuracy["ma_64"] <= accuracy["ma_4"] <= accuracy["moire"]
    assert rows["ma_64"]["success"] > rows["random_64"]["success"]
    assert rows["ma_64_targeted"]["success"] <= rows["ma_64"]["success"]


def test_every_attack_measures_its_noise(rows):
    for name, row in rows.items():
        attack = name.startswith(("ma_", "pgd_"))
        assert row["control"] != (attack or name == "worst_64")  # several attacks, and their noise
        for measure in ("psnr", "ssim", "ciede2000", "largest"):
            assert np.isfinite(row[measure]) == attack, (name, measure)
    assert rows["ma_4"]["largest"] < rows["ma_64"]["largest"]
    assert rows["ma_4"]["psnr"] > rows["ma_64"]["psnr"]
    assert 0 < rows["pgd_64"]["largest"] <= 64 / 255 + 1e-6  # pixels keep the bound
    assert rows["ma_4"]["largest"] > 4 / 255  # in linear light dark codes move further


def test_a_photo_measures_its_moire_and_nothing_else_does(rows):
    for name, row in rows.items():
        assert np.isfinite(row["moire"]) == np.isfinite(row["moire_seen"]) == (name == "moire")


MOIRE = {
    "mean light": (with_values(SCENE, {"sensor.exposure": "mean"}), 0, 0),
    "whole photos": (Scene.preset("phone_at_monitor"), 0.001, 1),
    "crops": (Scene.preset("phone_at_monitor").with_shrink((1, 3)), 0.5, 20),
}


@pytest.mark.parametrize(("scene", "low", "high"), MOIRE.values(), ids=MOIRE)
def test_moire_is_the_photo_minus_its_twin(scene, low, high, known):
    cells = [Cell(one.name, "answer", (one,)) for one in (PhotoWithoutMoire(), Photo())]
    table = Table("ladder", tuple(cells))
    images = torch.rand(16, 3, 1, 1, generator=torch.Generator().manual_seed(0))
    data = [(part.expand(-1, -1, 32, 32), torch.zeros(8).long()) for part in images.split(8)]
    frame = frame_of((known[0], data), table, scene=scene)
    photos, twins = (frame[frame["row"] == row] for row in ("moire", "no_moire"))
    assert twins["moire"].isna().all() and low <= photos["moire"].median() <= high
    line = rates(frame).set_index("row").loc["moire"]
    assert line["moire"] == photos["moire"].median()
    assert line["moire_seen"] == (photos["moire"] > 2).mean()


def test_success_is_counted_on_what_was_right_when_clean(known):
    model, data = known
    # half of the labels are not what the model says
    wrong = [(x, (y + (torch.arange(8) < 4)) % 4) for x, y in data]
    clean = climbed(model, wrong, (8 / 255,), 2, only=("clean", "ma_8"))["clean"]
    assert clean["accuracy"] == 0.5 and clean["counted"] == 8 and clean["success"] == 0.0


def test_two_models_meet_the_same_photos(known):
    seen = []
    for _ in range(2):
        seen.append([])

        def spy(x):
            seen[-1].append(x.detach().clone())
            return x.mean((2, 3)) @ torch.ones(3, 4)

        climbed(spy, known[1], seed=5, only=("dimmed", "no_moire", "moire", "random_64"))
    # two batches of five conditions, the clean images among them; the classes are counted on one
    # image each
    assert len(seen[0]) == 12
    assert all(torch.equal(a, b) for a, b in zip(*seen, strict=True))


@pytest.mark.parametrize("name", PRESETS)
def test_no_moire_is_the_photo_less_its_stripes(name):
    """On a grey screen without noise, reflections, pulses and JPEG, nothing is left to see."""
    scene, replace = Scene.preset(name), dataclasses.replace
    scene = replace(
        scene,
        panel=replace(scene.panel, glare=0.0, pwm=0.0),
        sensor=replace(scene.sensor, read_noise=0.0, gain=1.0),
        view=replace(scene.view, yaw=0.0, pitch=0.0, roll=0.0, pose="camera"),
        lens=replace(scene.lens, k1=0.0),
        develop=replace(scene.develop, jpeg=0.0),
    )
    grey, shot = torch.full((2, 3, 24, 24), 0.5), scene.sample(2, (24, 24))
    with_stripes, without = capture(grey, shot), capture(grey, without_moire(shot))
    assert without[..., 2:-2, 2:-2].std((2, 3)).max() < 1e-5
    if name.startswith("paper"):
        assert with_stripes.std() > 0.05
    assert "layout" not in without_moire(shot).scene.plan()


def test_images_without_an_answer_are_wrong_and_counted(known):
    """Also where a model has none at all."""
    zeros = [(x, torch.zeros_like(y)) for x, y in known[1]]  # as if argmax of NaN were an answer
    for level in (0.5, 2.0):

        def silent(x, level=level):
            dark = x.mean((1, 2, 3)) < level
            return torch.where(dark[:, None], torch.nan, known[0](x))

        rows = climbed(silent, zeros, (8 / 255,), 1, ("clean", "moire", "ma_8", "worst_8"))
        assert 0 < rows["clean"]["undecided"] < 16 or level == 2
        assert all(r["accuracy"] <= 1 - r["undecided"] / 16 for r in rows.values())
    assert all(r["undecided"] == 16 for r in rows.values())
