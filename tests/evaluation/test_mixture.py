"""An evaluation in a list of scenes: every image in its own, the same for all conditions."""

import pytest
import torch

from moireaug import Scene, capture
from moireaug.attacks import MoireAttack
from moireaug.evaluation import SUITES, SuiteConfig, evaluate, rates, tables_of
from moireaug.evaluation.classifiers import UNDEFENDED
from moireaug.evaluation.conditions import Photo, PhotoWithoutMoire
from moireaug.evaluation.suites.scenes import other_scenes
from moireaug.evaluation.visibility import visibility
from moireaug.mixtures import as_scenes
from moireaug.scene.draws import mix_seeds
from moireaug.synthesis import without_moire
from tests.evaluation.haze import CONDITIONS, EPS, ran, results, table_of

NAMES = ["screen_photo", "phone_at_laptop"]
MIXTURE = as_scenes(NAMES)


@pytest.fixture(scope="module")
def shot(known):
    images = known[1][0][0]
    found = MIXTURE.sample(len(images), (16, 16), torch.Generator().manual_seed(mix_seeds(3, 0, 0)))
    assert len(found.by_scene()) == 2
    return found


def test_each_condition_shows_every_image_in_its_scene(known, shot):
    model, batches = known
    images, labels = batches[0]
    plain = torch.empty_like(images)
    for rows, part in shot.by_scene():
        plain[rows] = capture(images[rows], without_moire(part))
    attack = MoireAttack(model, scene=MIXTURE, eps=EPS, steps=2, until_fooled=True)
    attacked = attack(images, labels, shot=shot).images
    table = table_of(Photo(), PhotoWithoutMoire(), CONDITIONS["ma"])
    runner = ran(known, table, (0,), scene=MIXTURE)
    expected = [capture(images, shot), plain, attacked]
    for cell, shown in zip(table.cells, expected, strict=True):
        (condition,) = cell.conditions
        record = runner.record(condition, UNDEFENDED, 0)
        assert torch.equal(runner.records.pictures[runner.picture_name(condition)], shown)
        with torch.no_grad():
            assert record["predicted"] == model(shown).argmax(1).tolist()
        assert record["labels"] == labels.tolist()
    for name, values in visibility(attacked, capture(images, shot)).items():
        assert record["measured"][name] == pytest.approx(values, rel=1e-4)


def test_seeds_repeat_and_every_key_knows_the_list_of_scenes(known):
    table = table_of(Photo(), CONDITIONS["random"])
    runner = ran(known, table, (0,), scene=MIXTURE)
    assert results(runner) == results(ran(known, table, (0,), scene=MIXTURE))
    keys = {runner.key(Photo(), UNDEFENDED, 0)}
    for other in (MIXTURE.scenes[0], as_scenes([*NAMES, "paper"]), as_scenes(NAMES[::-1])):
        keys.add(ran(known, table, (), scene=other).key(Photo(), UNDEFENDED, 0))
    assert len(keys) == 4


def test_evaluate_takes_a_list_and_resumes(known, tmp_path):
    model, batches = known
    settings = {"suite": "worst_case", "steps": 1, "n": 6, "progress": False}
    settings |= {"scene": NAMES, "folder": tmp_path}
    frame = evaluate(model, batches, **settings)
    assert frame["image"].nunique() == 6 and rates(frame)["n"].eq(6).all()
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*") if path.is_file()}
    assert evaluate(model, batches, **settings).equals(frame)
    assert {path: path.stat().st_mtime_ns for path in kept} == kept


def test_every_suite_is_laid_out():
    for name in SUITES:
        (table,) = tables_of(name, SuiteConfig(scene=MIXTURE, steps=1))
        (other,) = tables_of(name, SuiteConfig(scene=MIXTURE.scenes[0], steps=1))
        assert table.columns == other.columns, name
        own = [cell for cell in other.cells if cell.row != NAMES[1]]  # which is not unseen
        assert [(c.row, c.column) for c in table.cells] == [(c.row, c.column) for c in own], name


def test_the_scenes_of_a_mixture_are_not_unseen():
    assert not set(NAMES) & other_scenes(SuiteConfig(scene=MIXTURE)).keys()


def test_the_camera_is_turned_only_where_every_scene_allows_it():
    still = Scene.preset("paper")
    for scene, turned in ((NAMES, True), ([NAMES[0], still], False)):
        (table,) = tables_of("adaptive", SuiteConfig(scene=as_scenes(scene)))
        assert ("turning" in table.columns) == turned
