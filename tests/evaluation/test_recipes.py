"""What compares recipes: the worst case is its attackers' worst, image by image; unseen scenes are other scenes."""

import dataclasses

import pytest
import torch
from torch import nn

from moireaug import Scene
from moireaug.evaluation import GROUPS, SUITES, Given, Index, climb, complete, gather, ladder, sweep, tables_of
from moireaug.evaluation.grids import natural, tidy, verdict
from moireaug.evaluation.recipes import CAMERA, OWN, others
from moireaug.evaluation.sweep import MODEL
from moireaug.scene.presets import PRESETS

SCENE = Scene.preset("screen_photo")
GIVEN = Given(scene=SCENE, steps=2)


def swept(model, batches, tables, scene=SCENE):
    jobs = complete([job for t in tables for job in t.jobs()])
    return Index(r for new in sweep(model, batches.__getitem__, range(len(batches)), scene, jobs, seed=3) for r in new)


@pytest.fixture(scope="module")
def measured(known):
    """(tables by name, index, tidy rows by (row, column))."""
    tables = {t.name: t for t in tables_of("recipes", GIVEN)}
    index = swept(*known, tables.values())
    return tables, index, {(r["row"], r["column"]): r for t in tables.values() for r in tidy(t, index)}


def test_groups_share_out_the_suites():
    assert GROUPS["recipes"] == ("worst_case", "unseen")
    assert sorted(GROUPS["paper"] + GROUPS["recipes"]) == sorted(SUITES)
    assert [t.name for t in tables_of("paper", GIVEN)] == list(GROUPS["paper"])
    assert [t.name for t in tables_of("unseen", GIVEN)] == ["unseen"]


def test_the_worst_case_is_each_images_worst(measured):
    tables, index, found = measured
    table = tables["worst_case"]
    assert table.rows == ("ε = 4", "ε = 8")
    for row in table.rows:
        seen = [gather(index, *table.cells[row, c].rungs, MODEL).correct for c in CAMERA]
        every = [all(image) for image in zip(*seen, strict=True)]
        worst = found[row, "worst case"]
        assert worst["accuracy"] == sum(every) / 16 and worst["n"] == 16
        assert worst["accuracy"] <= min(found[row, c]["accuracy"] for c in CAMERA)
        assert worst["success"] == 1 - worst["accuracy"]  # every image counts


def test_pixels_and_chance_are_no_part_of_the_worst_case(measured):
    table = measured[0]["worst_case"]
    for row in table.rows:
        worst = {rung.name for rung in table.cells[row, "worst case"].rungs}
        assert len(worst) == len(CAMERA)
        beside = ("clean", "random noise", "PGD on pixels")
        assert not worst & {rung.name for c in beside for rung in table.cells[row, c].rungs}


def test_the_controls_are_the_ladders(measured, known):
    *_, rows = climb(known[0], known[1], SCENE, ladder((4 / 255,), 2), seed=3)
    accuracy = {row.name: row.accuracy for row in rows}
    found = measured[2]
    for row, column, name in (
        ("ε = 4", "clean", "clean"), ("ε = 4", "moiré, δ = 0", "moire"), ("ε = 8", "moiré, δ = 0", "moire"),
        ("ε = 4", "MA", "ma_4"), ("ε = 4", "PGD on pixels", "pgd_4"), (OWN, "moiré, δ = 0", "moire"),
        (OWN, "no moiré", "no_moire"),
    ):  # fmt: skip
        assert found[row, column]["accuracy"] == accuracy[name], (row, column)


def test_unseen_scenes_are_others_in_the_images_frame():
    registered = {name for name, scene in PRESETS.items() if scene.develop.registered}
    assert {"paper", "paper_code"}.isdisjoint(registered)
    for name in PRESETS:
        scene = Scene.preset(name)
        assert set(others(scene)) == registered - {name}
        (table,) = tables_of("unseen", dataclasses.replace(GIVEN, scene=scene))
        assert table.rows == (OWN, *others(scene)) and f", {name};" in table.note
    custom = dataclasses.replace(SCENE, view=dataclasses.replace(SCENE.view, roll=1.0))
    assert set(others(custom)) == registered


def test_an_unseen_scene_is_what_that_scene_shows(measured, known):
    scene = Scene.preset("dashcam_at_led_sign")
    there = swept(*known, tables_of("unseen", dataclasses.replace(GIVEN, scene=scene)), scene)
    for rung in ("moire", "no_moire"):
        own = gather(there, dataclasses.replace(ladder()[0], name=rung), MODEL)
        row = {"moire": "moiré, δ = 0", "no_moire": "no moiré"}[rung]
        assert measured[2]["dashcam_at_led_sign", row]["accuracy"] == own.accuracy


def test_the_tables_say_what_they_show(measured):
    tables, index, _ = measured
    rows = {name: tidy(t, index) for name, t in tables.items()}
    assert "the photo alone fools" in str(verdict(tables["worst_case"], rows["worst_case"]))
    assert verdict(tables["unseen"], rows["unseen"]) is None
    assert natural(tables["unseen"], rows["unseen"]).startswith("Without any attacker the moiré adds most for ")
    assert natural(tables["worst_case"], rows["worst_case"]) == ""


class Deaf(nn.Module):
    """Says one class, whatever it is shown."""

    def forward(self, images):
        return torch.tensor([0.0, 1.0, 0.0]).expand(len(images), 3) + 0 * images.mean((1, 2, 3))[:, None]


def test_nothing_fools_a_model_that_does_not_look(known):
    """Negative control: a table that finds success here counts wrongly."""
    batches = [(known[1][0][0], torch.tensor([1, 1, 1, 1, 1, 1, 0, 2]))]
    tables = tables_of("recipes", GIVEN)
    index = swept(Deaf().eval(), batches, tables)
    for row in (r for t in tables for r in tidy(t, index)):
        assert (row["success"], row["accuracy"], row["counted"]) == (0.0, 0.75, 6), (row["row"], row["column"])
