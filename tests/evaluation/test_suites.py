"""Suites: the worst case is its attackers' worst, image by image; unseen scenes are others."""

import dataclasses

import numpy as np
import pytest
import torch

from moireaug import Scene
from moireaug.defenses import JPEG
from moireaug.evaluation import GROUPS, SUITES, SuiteConfig, images_frame, rates, tables_of
from moireaug.evaluation.attackers import Attacker
from moireaug.evaluation.conditions import Photo, PhotoWithoutMoire
from moireaug.evaluation.judges import UNDEFENDED
from moireaug.evaluation.runner import jobs_of
from moireaug.evaluation.suites.scenes import OWN_SCENE_ROW, other_scenes
from moireaug.evaluation.suites.threat_scenes import DISPLAY_CAMERA_PAIRS, threat_scene
from moireaug.mixtures import scenes_of
from moireaug.scene.presets import PRESETS
from tests.evaluation.haze import cell_of, frame_of, ran, table_of

SCENE = Scene.preset("screen_photo")
WORST_CASE_COLUMNS = ("moire", "ma", "apgd")
CONFIG = SuiteConfig(scene=SCENE, steps=1)


def run_suite(model, batches, suite, config=CONFIG):
    """(tables by name, images, rates)."""
    tables = tables_of(suite, config)
    runner = ran((model, batches), tables, scene=config.scene)
    images = images_frame(tables, runner, range(len(batches)))
    return {table.name: table for table in tables}, images, rates(images)


@pytest.fixture(scope="module")
def measured(known):
    return run_suite(*known, "recipes")


def test_groups_share_out_the_suites():
    alone = {"ladder", "full_ladder", "standard", "shifts", "trust"}
    assert sorted(GROUPS["paper"] + GROUPS["recipes"]) == sorted(SUITES.keys() - alone)
    assert [table.name for table in tables_of("paper", CONFIG)] == list(GROUPS["paper"])
    assert [table.name for table in tables_of("unseen", CONFIG)] == ["unseen"]


def test_a_missing_defence_of_the_paper_is_named():
    mine = SuiteConfig(scene=SCENE, defences={"mine": JPEG(30)})
    for name in ("jpeg", "mean_normalised", "noise_position", "adaptive"):
        with pytest.raises(ValueError, match=r"needs the defence '\w+'.*paper_defences\(\) \| \{"):
            tables_of(name, mine)


def test_conditions_of_one_name_are_one():
    """Within a suite a name means one thing, also where float32 has rounded the bounds."""
    rounded = tuple((torch.tensor([2.0, 4.0, 8.0]) / 255).tolist())
    for suite in (*SUITES, *GROUPS):
        jobs = jobs_of(tables_of(suite, dataclasses.replace(CONFIG, eps=rounded)))
        names = [job.condition.name for job in jobs]
        assert len(set(names)) == len(names) > 1, suite


def test_the_worst_case_is_each_images_worst(measured):
    tables, images, lines = measured
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


def test_the_worst_case_means_the_same_in_every_table():
    """The photo alone, and each attack through the camera within its bound."""
    tables = [tables_of(suite, CONFIG)[0] for suite in SUITES]
    cases = [(table, cell) for table in tables for cell in table.cells if cell.worst]
    assert len(cases) > 8
    for table, worst in cases:
        left_out = ("pose_unknown", "turning") if table.name == "adaptive" else ()  # rows lack them
        if worst.column != "worst_scene":
            left_out += ("scene",)
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
    config = dataclasses.replace(CONFIG, eps=(16 / 255,))
    lines = run_suite(*known, "full_ladder", config)[2]
    success = lines.set_index("row")["success"]
    for row in ("moire", "ma_16", "adaptive_16", "pose_unknown_16"):
        assert success["worst_case_16"] >= success[row]
    assert table.columns == ["fooled"]


def test_the_controls_are_the_ladders(measured):
    (ladder,) = tables_of("ladder", CONFIG)
    others = {"clean": "clean", "moire": "moire", "ma": "ma_4", "pgd": "pgd_4"}
    cells = {row: measured[0]["worst_case"].cell("eps_4", name) for name, row in others.items()}
    cells["no_moire"] = measured[0]["unseen"].cell(OWN_SCENE_ROW, "no_moire")
    for row, cell in cells.items():
        assert cell.conditions == ladder.cell(row, "answer").conditions, row


def test_unseen_scenes_are_others_in_the_images_frame():
    registered = {name for name, scene in PRESETS.items() if scene.develop.registered}
    assert {"paper", "paper_code"}.isdisjoint(registered)
    for name in PRESETS:
        scene = Scene.preset(name)
        config = dataclasses.replace(CONFIG, scene=scene)
        assert set(other_scenes(config)) == registered - {name}
        (table,) = tables_of("unseen", config)
        assert table.rows == [OWN_SCENE_ROW, *other_scenes(config)] and table.facts["own"] == name
    custom = dataclasses.replace(SCENE, view=dataclasses.replace(SCENE.view, roll=1.0))
    assert set(other_scenes(SuiteConfig(scene=custom))) == registered


def test_all_scenes_of_a_suite_are_of_crops_where_images_are():
    config = SuiteConfig(scene=["phone_at_phone", "dashcam_at_led_sign"], shrink=(1, 3), steps=1)
    (unseen,) = tables_of("unseen", config)
    assert unseen.facts["own"] == "phone_at_phone or dashcam_at_led_sign"
    assert not {"phone_at_phone", "dashcam_at_led_sign"} & set(unseen.rows)
    for name in ("unseen", "threat", "shifts", "factors"):
        (table,) = tables_of(name, config)
        conditions = [condition for cell in table.cells for condition in cell.conditions]
        shown = [scenes_of(condition.scene) for condition in conditions if condition.scene]
        assert shown and all(scene.is_crop for scenes in shown for scene in scenes), name
    cell = next(cell for cell in table.cells if cell.row == "alpha_3")
    assert cell.conditions[0].scene.scenes[0].sensor.shrink == (1.5, 4.5)


def test_an_unseen_scene_is_what_that_scene_shows(measured, known):
    conditions, scene = (Photo(), PhotoWithoutMoire()), Scene.preset("dashcam_at_led_sign")
    runner = ran(known, table_of(*conditions), scene=scene)
    for condition, column in zip(conditions, ("moire", "no_moire"), strict=True):
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
    images = frame_of(known, table)
    lines = rates(images)
    pooled = cell_of(lines, "monitor, Sony", "all")
    assert pooled["n"] == 128 and pooled["condition"] == "8 pooled"
    assert images[images["column"] == "all"]["image"].nunique() == 16
    angles = lines[lines["column"].str.startswith("angle_")]
    assert len(angles) == 8 and pooled["success"] == pytest.approx(angles["success"].mean())
    assert pooled["high"] - pooled["low"] > 0.15  # a Wilson interval of 128 would be 0.1 wide


SENSOR_WIDTHS = {"Pixel 4": 4032, "P20 Pro": 3648, "Sony": 6000}  # pixels


def test_the_papers_displays_are_screens_that_fit_on_their_sensors():
    for display, camera in DISPLAY_CAMERA_PAIRS:
        scene = threat_scene(display, camera, 30)
        low, high = scene.panel.width
        assert 100 < low < high and high * scene.sensor.pitch <= SENSOR_WIDTHS[camera]
        assert scene.view.fov[1] > 2 * scene.view.fov[0]  # the picture's own angle


def test_a_scene_without_a_choice_of_pose_says_so():
    view = dataclasses.replace(SCENE.view, yaw=0.0, pitch=0.0, roll=0.0)
    still = dataclasses.replace(SCENE, view=view)
    (table,) = tables_of("adaptive", dataclasses.replace(CONFIG, scene=still))
    assert "turning" in table.columns  # the panel still varies
    (table,) = tables_of("adaptive", dataclasses.replace(CONFIG, scene=Scene.preset("paper_code")))
    assert "turning" not in table.columns
    assert table.facts["why_not_turned"].startswith("optimise")


def deaf(images):
    """Says one class, whatever it is shown."""
    return torch.tensor([0.0, 1.0, 0.0]).repeat(len(images), 1) + 0 * images.mean()


@pytest.mark.parametrize("suite", ["worst_case", "unseen", "adaptive", "jpeg", "demoireing"])
def test_nothing_fools_a_model_that_does_not_look(known, suite):
    """Negative control: a table that finds success here counts wrongly."""
    batches = [(known[1][0][0][:4], torch.tensor([1, 1, 1, 2]))]
    (table,) = tables_of(suite, CONFIG)
    if suite == "adaptive":
        rows = ("undefended", "median_3")
        table = dataclasses.replace(table, cells=tuple(c for c in table.cells if c.row in rows))
        assert table.rows == list(rows)
    for line in rates(frame_of((deaf, batches), table)).to_dict("records"):
        found = (line["success"], line["accuracy"], line["counted"])
        assert found == (0.0, 0.75, 3), (line["row"], line["column"])


def test_a_config_takes_the_name_of_a_scene():
    assert SuiteConfig(scene="screen_photo").scene == SCENE


def test_a_condition_is_called_like_its_row():
    (table,) = tables_of("full_ladder", CONFIG)
    (cell,) = [cell for cell in table.cells if cell.row == "pose_unknown_4"]
    assert cell.conditions[0].name == "pose_unknown_4"
