"""Suites: the worst case is its attackers' worst, image by image; unseen scenes are others."""

import dataclasses

import numpy as np
import pytest
import torch
from torch import nn

from moireaug import Scene
from moireaug.attacks import ATTACKS, CW
from moireaug.defenses import JPEG
from moireaug.evaluation import (
    GROUPS,
    SUITES,
    Cell,
    SuiteConfig,
    Table,
    evaluate,
    images_frame,
    rates,
    tables_of,
)
from moireaug.evaluation.attackers import MoireAttacker, PixelAttacker
from moireaug.evaluation.classifiers import UNDEFENDED, Classifier
from moireaug.evaluation.conditions import Photo, PhotoWithoutMoire, RandomNoise
from moireaug.evaluation.runner import jobs_of
from moireaug.evaluation.suites.scenes import OWN_SCENE_ROW, other_scenes
from moireaug.evaluation.tables import cross
from moireaug.mixtures import scenes_of
from moireaug.scene.presets import PRESETS
from tests.evaluation.haze import EPS, cell_of, ran, table_of
from tests.evaluation.suite_checks import (
    ROUNDED_EPS,
    check_names,
    check_that_nothing_fools_the_deaf,
    check_worst_cases,
)

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


def test_a_group_is_its_suites_in_turn():
    assert [table.name for table in tables_of("recipes", CONFIG)] == list(GROUPS["recipes"])
    assert [table.name for table in tables_of("unseen", CONFIG)] == ["unseen"]


def test_a_missing_defence_of_the_paper_is_named():
    mine = SuiteConfig(scene=SCENE, defences={"mine": JPEG(30)})
    with pytest.raises(ValueError, match=r"needs the defence '\w+'.*paper_defences\(\) \| \{"):
        tables_of("adaptive", mine)


def own_suite(config):
    """A suite of a user's: the photo, and the attack."""
    conditions = {"photo": Photo(), "ma": MoireAttacker(eps=config.middle, steps=config.steps)}
    return Table("own", tuple(cross({"model": UNDEFENDED}, conditions)))


def test_a_function_is_a_suite():
    (table,) = tables_of(own_suite, CONFIG)
    assert table.columns == ["photo", "ma"]
    other = dataclasses.replace(table, name="other")
    assert tables_of(lambda config: [table, other], CONFIG) == [table, other]
    for other in (lambda config: "own", lambda config: None, lambda config: [3]):
        with pytest.raises(TypeError, match=r"suite must return a moireaug\.evaluation\.Table, or"):
            tables_of(other, CONFIG)


PHOTO = {"photo": Photo()}


def by_jpeg(quality):
    return Classifier("jpeg", JPEG(quality))


WRONG_SUITES = {  # a function of a user's, and what it is told
    "attack": (lambda: PixelAttacker(attack="pdg", eps=0.1, steps=1), "Did you mean 'pgd'"),
    # whose camera would be of another scene
    "an attack by a camera": (lambda: PixelAttacker(attack="ma", eps=0, steps=1), "one of 'pgd'"),
    "eps": (lambda: RandomNoise(eps=8), "eps is in .0, 1. units.*Divide by 255"),
    "no eps of an attack": (lambda: MoireAttacker(steps=1), "missing .* 'eps'"),
    "no eps of noise": (lambda: RandomNoise(), "missing .* 'eps'"),
    "a bound of cw": (lambda: PixelAttacker(attack="cw", eps=0.1, steps=1), "no bound.*got 0.1"),
    "another model to know": (
        lambda: MoireAttacker(eps=0.1, steps=1, known_classifier=Classifier("b", model=len)),
        "evaluated model.*'b', whose model",
    ),
    "a mean to know": (
        lambda: MoireAttacker(
            eps=0.1, steps=1, known_classifier=Classifier("m", restores_mean=True)
        ),
        "'m', whose restores_mean",
    ),
    "no condition": (lambda: Cell("row", "column", ()), "'row'.*one or more conditions.*got ()"),
    "no tuple": (lambda: Cell("row", "column", Photo()), r"as in \(Photo\(\),\); got Photo"),
    "a model": (
        lambda: Cell("a", "b", (Photo(),), nn.Identity()),
        "takes a Classifier.*got Identity",
    ),
    "one place": (lambda: Table("t", 2 * (Cell("a", "b", (Photo(),)),)), "two cells of .*'a', 'b'"),
    "one classifier": (
        lambda: jobs_of([Table("t", tuple(cross({"a": by_jpeg(20), "b": by_jpeg(60)}, PHOTO)))]),
        "two classifiers of one condition are called 'jpeg'",
    ),
    "one name": (
        lambda: tables_of(lambda _: 2 * [Table("t", ())], CONFIG),
        "different names.*t, t",
    ),
}


@pytest.mark.parametrize("name", WRONG_SUITES)
def test_a_wrong_suite_is_refused_when_it_is_laid_out(name):
    make, message = WRONG_SUITES[name]
    with pytest.raises((ValueError, TypeError), match=message):
        make()


def test_a_targeted_attacker_says_so_in_its_name():
    """Or it could not stand beside the untargeted one."""
    for kind, settings in ((MoireAttacker, {}), (PixelAttacker, {"attack": "pgd"})):
        attacker = kind(eps=4 / 255, steps=1, targeted=True, **settings)
        assert attacker.name == dataclasses.replace(attacker, targeted=False).name + "_targeted"


def test_conditions_of_one_name_are_one():
    for suite in (*SUITES, *GROUPS):
        check_names(tables_of(suite, dataclasses.replace(CONFIG, eps=ROUNDED_EPS)))


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
    left_out = {"adaptive": ("photo_unknown", "turning")}  # only the undefended row has them
    assert check_worst_cases([tables_of(suite, CONFIG)[0] for suite in SUITES], left_out) > 6


def test_the_full_ladder_adds_rows_to_the_ladder(known):
    (table,), (short,) = tables_of("full_ladder", CONFIG), tables_of("ladder", CONFIG)
    added = {"rotated", "photo_unknown_4", "adaptive_4", "worst_case_4"}
    assert set(table.rows) - set(short.rows) == added
    assert table.rows[:4] == ["clean", "dimmed", "rotated", "no_moire"]
    assert set(short.rows) - set(table.rows) == {"worst_4"}
    config = dataclasses.replace(CONFIG, eps=(16 / 255,))
    lines = run_suite(*known, "full_ladder", config)[2]
    success = lines.set_index("row")["success"]
    for row in ("moire", "ma_16", "adaptive_16", "photo_unknown_16"):
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
        assert table.rows == [OWN_SCENE_ROW, *other_scenes(config)]
    custom = dataclasses.replace(SCENE, view=dataclasses.replace(SCENE.view, roll=1.0))
    assert set(other_scenes(SuiteConfig(scene=custom))) == registered


def test_all_scenes_of_a_suite_are_of_crops_where_images_are():
    config = SuiteConfig(scene=["phone_at_phone", "dashcam_at_led_sign"], shrink=(1, 3), steps=1)
    (unseen,) = tables_of("unseen", config)
    assert not {"phone_at_phone", "dashcam_at_led_sign"} & set(unseen.rows)
    conditions = [condition for cell in unseen.cells for condition in cell.conditions]
    shown = [scenes_of(condition.scene) for condition in conditions if condition.scene]
    assert shown and all(scene.is_crop for scenes in shown for scene in scenes)


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


def test_a_scene_without_a_choice_of_pose_has_no_attacker_who_turns():
    view = dataclasses.replace(SCENE.view, yaw=0.0, pitch=0.0, roll=0.0)
    still = dataclasses.replace(SCENE, view=view)
    (table,) = tables_of("adaptive", dataclasses.replace(CONFIG, scene=still))
    assert "turning" in table.columns  # the panel still varies
    (table,) = tables_of("adaptive", dataclasses.replace(CONFIG, scene=Scene.preset("paper_code")))
    assert "turning" not in table.columns


@pytest.mark.parametrize("suite", ["worst_case", "unseen", "adaptive"])
def test_nothing_fools_a_model_that_does_not_look(known, suite):
    (table,) = tables_of(suite, CONFIG)
    if suite == "adaptive":
        rows = ("undefended", "median_3")
        table = dataclasses.replace(table, cells=tuple(c for c in table.cells if c.row in rows))
        assert table.rows == list(rows)
    check_that_nothing_fools_the_deaf(known, table)


class Unmoved(nn.Module):
    """Counts the images it sees, with a gradient and without; noise hardly moves its logits."""

    def __init__(self):
        super().__init__()
        self.shown = {True: 0, False: 0}

    def forward(self, images):
        self.shown[images.requires_grad] += len(images)
        return torch.tensor([9.0] + 9 * [0.0]) + 1e-3 * images[:, 0, 0, :10]


@pytest.mark.parametrize(("suite", "passes"), [("ladder", (15, 0)), ("standard", (16, 50))])
def test_passes_of_an_image_that_nothing_fools(suite, passes):
    """docs/evaluation.md states them, per step, of standard also per eps."""
    shown, batch = {}, (torch.rand(1, 3, 16, 16), torch.zeros(1, dtype=torch.int64))
    eps = 8 / 255 if suite == "standard" else None
    for steps in (1, 2):
        model = Unmoved()
        evaluate(model, [batch], suite, eps=eps, steps=steps, progress=False)
        shown[steps] = model.shown
    assert passes == tuple(shown[2][key] - shown[1][key] for key in (True, False))


def test_a_config_takes_the_name_of_a_scene():
    assert SuiteConfig(scene="screen_photo").scene == SCENE


def test_a_config_takes_the_bounds_that_evaluate_takes():
    for eps in (EPS, [EPS], np.array([EPS]), torch.tensor(EPS)):
        assert SuiteConfig(scene=SCENE, eps=eps).eps == (EPS,)


def test_a_condition_is_called_like_its_row():
    (table,) = tables_of("full_ladder", CONFIG)
    (cell,) = [cell for cell in table.cells if cell.row == "photo_unknown_4"]
    assert cell.conditions[0].name == "photo_unknown_4"


def test_an_attack_says_whether_it_has_a_bound(monkeypatch):
    """Whatever its name."""
    for attack in ATTACKS.values():
        settings = {field.name for field in dataclasses.fields(attack)}
        assert attack.has_bound == ("eps" in settings)
    monkeypatch.setitem(ATTACKS, "pgd", CW)
    with pytest.raises(ValueError, match="'pgd' has no bound"):
        PixelAttacker(attack="pgd", eps=0.1, steps=1)
    assert PixelAttacker(attack="pgd", eps=0.0, steps=1, until_fooled=False).name == "pgd"
    assert PixelAttacker(attack="cw", eps=0.0, steps=1, until_fooled=False).name == "cw"
