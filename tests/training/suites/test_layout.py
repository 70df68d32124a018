"""The paper's suites: every name means one thing, crops stay crops, and what one changes it changes
in every scene of a mixture."""

import dataclasses

import pytest

from moireaug import Scene
from moireaug.defenses import JPEG
from moireaug.evaluation import rates
from moireaug.evaluation.tables import paper_defences
from moireaug.mixtures import as_scenes, scenes_of
from tests.evaluation.haze import cell_of, frame_of
from tests.evaluation.suite_checks import (
    ROUNDED_EPS,
    check_bounds_of_rows,
    check_names,
    check_that_nothing_fools_the_deaf,
    check_worst_cases,
)
from training.suites import GROUPS, OPTION_SUITES, PAPER_SUITES, SUITES, tables_of
from training.suites.config import PaperConfig
from training.suites.threat_scenes import DISPLAY_CAMERA_PAIRS, threat, threat_scene

SCENE = Scene.preset("screen_photo")
CONFIG = PaperConfig(scene=SCENE, steps=1)
NAMES = ["screen_photo", "phone_at_laptop"]
MIXTURE = as_scenes(NAMES)
OWN_SUITES = (*PAPER_SUITES, "shifts")


def test_a_group_is_its_suites_in_turn():
    assert [table.name for table in tables_of("paper", CONFIG)] == list(GROUPS["paper"])
    for suites in OPTION_SUITES.values():
        assert set(suites) <= {*SUITES, *GROUPS} and len(set(suites)) == len(suites)


def test_a_missing_defence_of_the_paper_is_named():
    mine = PaperConfig(scene=SCENE, defences={"mine": JPEG(30)})
    for name in ("jpeg", "mean_normalised", "noise_position"):
        with pytest.raises(ValueError, match=r"needs the defence '\w+'.*paper_defences\(\) \| \{"):
            tables_of(name, mine)


def test_conditions_of_one_name_are_one():
    for suite in (*OWN_SUITES, "paper"):
        check_names(tables_of(suite, dataclasses.replace(CONFIG, eps=ROUNDED_EPS)))


def test_the_worst_case_means_the_same_in_every_table():
    assert check_worst_cases([tables_of(suite, CONFIG)[0] for suite in OWN_SUITES])


def test_all_scenes_of_a_suite_are_of_crops_where_images_are():
    config = PaperConfig(scene=["phone_at_phone", "dashcam_at_led_sign"], shrink=(1, 3), steps=1)
    for name in ("threat", "shifts", "factors"):
        (table,) = tables_of(name, config)
        conditions = [condition for cell in table.cells for condition in cell.conditions]
        shown = [scenes_of(condition.scene) for condition in conditions if condition.scene]
        assert shown and all(scene.is_crop for scenes in shown for scene in scenes), name
    cell = next(cell for cell in table.cells if cell.row == "alpha_3")
    assert cell.conditions[0].scene.scenes[0].sensor.shrink == (1.5, 4.5)


@pytest.mark.parametrize(
    ("suite", "bounds"), [("success", (2, 4, 6, 8)), ("budget", (4, 8, 16, 32))]
)
def test_a_suite_attacks_at_the_bounds_asked_for(suite, bounds):
    (usual,) = tables_of(suite, CONFIG)
    (asked,) = tables_of(suite, dataclasses.replace(CONFIG, eps=(8 / 255, 1 / 255)))
    assert usual.rows == [f"eps_{eps}" for eps in bounds] and asked.rows == ["eps_1", "eps_8"]
    for table in (usual, asked):
        check_bounds_of_rows(table)


def test_a_defence_stands_beside_the_papers():
    defences = paper_defences() | {"jpeg_75": JPEG(75)}
    (table,) = tables_of("defences", PaperConfig(scene=SCENE, defences=defences))
    assert "jpeg_75" in table.rows and "jpeg_80" not in table.rows


def test_every_suite_is_laid_out_in_a_mixture():
    for name in OWN_SUITES:
        (table,) = tables_of(name, PaperConfig(scene=MIXTURE, steps=1))
        (other,) = tables_of(name, PaperConfig(scene=MIXTURE.scenes[0], steps=1))
        assert table.columns == other.columns, name
        own = [cell for cell in other.cells if cell.row != NAMES[1]]  # which is not unseen
        assert [(c.row, c.column) for c in table.cells] == [(c.row, c.column) for c in own], name


def scenes_of_row(suite, row):
    (table,) = tables_of(suite, PaperConfig(scene=MIXTURE))
    (scene,) = {cell.conditions[0].scene for cell in table.cells if cell.row == row}
    return scene.scenes


def test_what_a_suite_changes_it_changes_in_every_scene():
    assert [scene.view.roll for scene in scenes_of_row("factors", "roll_15")] == [15, 15]
    enlarged = scenes_of_row("factors", "alpha_3")
    for own, scene in zip(enlarged, MIXTURE.scenes, strict=True):
        assert own.panel.width == pytest.approx(tuple(1.5 * w for w in scene.panel.width))
    assert [scene.develop.jpeg for scene in scenes_of_row("shifts", "photo_jpeg_60")] == [60, 60]
    assert not any(scene.develop.registered for scene in scenes_of_row("shifts", "camera_frame"))


def test_photos_of_one_image_are_no_independent_trials(known):
    """Eight angles of sixteen images have the interval of sixteen."""
    table = threat(CONFIG)
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


@pytest.mark.parametrize("suite", ["jpeg", "demoireing"])
def test_nothing_fools_a_model_that_does_not_look(known, suite):
    (table,) = tables_of(suite, CONFIG)
    check_that_nothing_fools_the_deaf(known, table)
