"""Suites: the worst case is its attackers' worst, image by image; unseen scenes are other scenes;
every published figure stands beside a cell."""

import dataclasses

import numpy as np
import pytest
import torch
from torch import nn

from moireaug import Scene
from moireaug.defenses import JPEG
from moireaug.evaluation import (
    GROUPS,
    SUITES,
    SuiteConfig,
    images_frame,
    rates,
    tables_of,
)
from moireaug.evaluation.attackers import Attacker
from moireaug.evaluation.conditions import Photo, PhotoWithoutMoire
from moireaug.evaluation.judges import UNDEFENDED
from moireaug.evaluation.runner import jobs_of
from moireaug.evaluation.suites.scenes import OWN_SCENE_ROW, other_scenes
from moireaug.evaluation.suites.threat_scenes import DISPLAY_CAMERA_PAIRS, threat_scene
from moireaug.scene.presets import PRESETS
from tests.evaluation.haze import cell_of, ran

SCENE = Scene.preset("screen_photo")
WORST_CASE_COLUMNS = ("moire", "ma", "apgd")
CONFIG = SuiteConfig(scene=SCENE, steps=2)


def run_suite(model, batches, suite, config=CONFIG):
    """(tables by name, images, rates, runner)."""
    tables = tables_of(suite, config)
    runner = ran((model, batches), tables, scene=config.scene)
    images = images_frame(tables, runner, range(len(batches)))
    return {table.name: table for table in tables}, images, rates(images), runner


@pytest.fixture(scope="module")
def measured(known):
    return run_suite(*known, "recipes")


def test_groups_share_out_the_suites():
    assert GROUPS["recipes"] == ("worst_case", "unseen")
    alone = {"ladder", "full_ladder", "standard", "shifts", "trust"}
    assert sorted(GROUPS["paper"] + GROUPS["recipes"]) == sorted(SUITES.keys() - alone)
    assert [table.name for table in tables_of("paper", CONFIG)] == list(GROUPS["paper"])
    assert [table.name for table in tables_of("unseen", CONFIG)] == ["unseen"]


@pytest.mark.parametrize("name", ["jpeg", "mean_normalised", "noise_position", "adaptive"])
def test_a_missing_defence_of_the_paper_is_named(name):
    mine = SuiteConfig(scene=SCENE, defences={"mine": JPEG(30)})
    with pytest.raises(ValueError, match=r"needs the defence '\w+'.*paper_defences\(\) \| \{"):
        tables_of(name, mine)


@pytest.mark.parametrize("name", sorted({*SUITES, *GROUPS}))
def test_conditions_of_one_name_are_one(name):
    """A record is looked up by what it means; within a suite its name must mean one thing, also
    where float32 has rounded the bounds."""
    rounded = tuple((torch.tensor([2.0, 4.0, 8.0]) / 255).tolist())
    jobs = jobs_of(tables_of(name, dataclasses.replace(CONFIG, eps=rounded)))
    names = [job.condition.name for job in jobs]
    assert len(set(names)) == len(names) > 1


def test_the_worst_case_is_each_images_worst(measured):
    tables, images, lines, _ = measured
    table = tables["worst_case"]
    assert table.rows == ["eps_4", "eps_8"]
    for row in table.rows:
        own = images[(images["table"] == "worst_case") & (images["row"] == row)]
        outcomes = own[own["column"].isin(WORST_CASE_COLUMNS)].groupby("image")["correct"].all()
        worst = cell_of(lines, row, "worst")
        assert worst["accuracy"] == outcomes.mean() and worst["n"] == 16
        each = [cell_of(lines, row, column)["accuracy"] for column in WORST_CASE_COLUMNS]
        assert worst["accuracy"] <= min(each)
        assert worst["success"] == 1 - worst["accuracy"]  # every image counts


@pytest.mark.parametrize("suite", SUITES)
def test_the_worst_case_means_the_same_in_every_table(suite):
    """The photo alone, and each attack through the camera within its bound."""
    (table,) = tables_of(suite, CONFIG)
    left_out = ("pose_unknown", "turning") if suite == "adaptive" else ()  # rows lack them
    for worst in (cell for cell in table.cells if cell.worst):
        names = {condition.name for condition in worst.conditions}
        assert "moire" in names and len(names) == len(worst.conditions) > 2
        eps = max(condition.eps for condition in worst.conditions)
        beside = [cell for cell in table.cells if cell.row == worst.row or len(table.columns) == 1]
        for cell in (cell for cell in beside if len(cell.conditions) == 1):
            (condition,) = cell.conditions
            attacks = isinstance(condition, Attacker) and cell.column not in left_out
            counts = attacks and condition.on_screen and condition.eps <= eps
            assert (condition.name in names) == (counts or condition.name == "moire"), worst.row


def test_the_full_ladder_adds_rows_to_the_ladder(known):
    (table,), (short,) = tables_of("full_ladder", CONFIG), tables_of("ladder", CONFIG)
    added = {"rotated", "pose_unknown_4", "adaptive_4", "worst_case_4"}
    assert set(table.rows) - set(short.rows) == added
    assert table.rows[:4] == ["clean", "dimmed", "rotated", "no_moire"]
    assert set(short.rows) - set(table.rows) == {"worst_4"}
    config = dataclasses.replace(CONFIG, steps=1, eps=(16 / 255,))
    lines = run_suite(*known, "full_ladder", config)[2]
    success = lines.set_index("row")["success"]
    for row in ("moire", "ma_16", "adaptive_16", "pose_unknown_16"):
        assert success["worst_case_16"] >= success[row]
    assert table.columns == ["fooled"]


def test_the_controls_are_the_ladders(measured, known):
    _, _, ladder, _ = run_suite(*known, "ladder")
    accuracy = ladder.set_index("row")["accuracy"]
    for row, column, name in (
        ("eps_4", "clean", "clean"),
        ("eps_4", "moire", "moire"),
        ("eps_8", "moire", "moire"),
        ("eps_4", "ma", "ma_4"),
        ("eps_4", "pgd", "pgd_4"),
        (OWN_SCENE_ROW, "moire", "moire"),
        (OWN_SCENE_ROW, "no_moire", "no_moire"),
    ):
        assert cell_of(measured[2], row, column)["accuracy"] == accuracy[name], (row, column)


def test_unseen_scenes_are_others_in_the_images_frame():
    registered = {name for name, scene in PRESETS.items() if scene.develop.registered}
    assert {"paper", "paper_code"}.isdisjoint(registered)
    for name in PRESETS:
        scene = Scene.preset(name)
        assert set(other_scenes(scene)) == registered - {name}
        (table,) = tables_of("unseen", dataclasses.replace(CONFIG, scene=scene))
        assert table.rows == [OWN_SCENE_ROW, *other_scenes(scene)] and table.facts["own"] == name
    custom = dataclasses.replace(SCENE, view=dataclasses.replace(SCENE.view, roll=1.0))
    assert set(other_scenes(custom)) == registered


def test_an_unseen_scene_is_what_that_scene_shows(measured, known):
    scene = Scene.preset("dashcam_at_led_sign")
    runner = run_suite(*known, "unseen", dataclasses.replace(CONFIG, scene=scene))[3]
    for condition, column in ((Photo(), "moire"), (PhotoWithoutMoire(), "no_moire")):
        right = 0
        for index in (0, 1):
            record = runner.record(condition, UNDEFENDED, index)
            right += np.equal(record["predicted"], record["labels"]).sum()
        there = cell_of(measured[2], "dashcam_at_led_sign", column, "unseen")
        assert there["accuracy"] == right / 16


def test_photos_of_one_image_are_no_independent_trials(known):
    """Eight angles of sixteen images have the interval of sixteen."""
    (table,) = tables_of("threat", CONFIG)
    own = [cell for cell in table.cells if cell.row == "monitor, Sony"]
    table = dataclasses.replace(table, cells=tuple(own))
    images = images_frame([table], ran(known, table), (0, 1))
    lines = rates(images)
    pooled = cell_of(lines, "monitor, Sony", "all")
    assert pooled["n"] == 128 and pooled["condition"] == "8 pooled"
    assert images[images["column"] == "all"]["image"].nunique() == 16
    angles = lines[lines["column"].str.startswith("angle_")]
    assert len(angles) == 8 and pooled["success"] == pytest.approx(angles["success"].mean())
    assert pooled["high"] - pooled["low"] > 0.15  # a Wilson interval of 128 would be 0.1 wide


SENSOR_WIDTHS = {"Pixel 4": 4032, "P20 Pro": 3648, "Sony": 6000}  # pixels


@pytest.mark.parametrize(("display", "camera"), DISPLAY_CAMERA_PAIRS)
def test_the_papers_displays_are_screens_that_fit_on_their_sensors(display, camera):
    scene = threat_scene(display, camera, 30)
    low, high = scene.panel.width
    assert 100 < low < high and high * scene.sensor.pitch <= SENSOR_WIDTHS[camera]
    assert scene.view.fov[1] > 2 * scene.view.fov[0]  # the picture's own angle


def test_a_scene_without_a_choice_of_pose_says_so():
    still = dataclasses.replace(
        SCENE, view=dataclasses.replace(SCENE.view, yaw=0.0, pitch=0.0, roll=0.0)
    )
    (table,) = tables_of("adaptive", dataclasses.replace(CONFIG, scene=still))
    assert "turning" in table.columns  # the panel still varies
    (table,) = tables_of("adaptive", dataclasses.replace(CONFIG, scene=Scene.preset("paper_code")))
    assert "turning" not in table.columns
    assert table.facts["why_not_turned"].startswith("optimise")


class Deaf(nn.Module):
    """Says one class, whatever it is shown."""

    def forward(self, images):
        return (
            torch.tensor([0.0, 1.0, 0.0]).expand(len(images), 3)
            + 0 * images.mean((1, 2, 3))[:, None]
        )


@pytest.mark.parametrize("suite", ["recipes", "adaptive", "jpeg", "demoireing"])
def test_nothing_fools_a_model_that_does_not_look(known, suite):
    """Negative control: a table that finds success here counts wrongly."""
    batches = [(known[1][0][0][:4], torch.tensor([1, 1, 1, 2]))]
    config = dataclasses.replace(CONFIG, steps=1)
    lines = run_suite(Deaf().eval(), batches, suite, config)[2]
    for line in lines.to_dict("records"):
        found = (line["success"], line["accuracy"], line["counted"])
        assert found == (0.0, 0.75, 3), (line["row"], line["column"])


def test_a_config_takes_the_name_of_a_scene():
    assert SuiteConfig(scene="screen_photo").scene == SCENE


def test_a_condition_is_called_like_its_row():
    (table,) = tables_of("full_ladder", CONFIG)
    (cell,) = [cell for cell in table.cells if cell.row == "pose_unknown_4"]
    assert cell.conditions[0].name == "pose_unknown_4"
