"""Suites through the real command: every table, nothing computed twice, the same figures from
several processes."""

import csv
import json
import warnings

import pytest

from moireaug.evaluation import SuiteConfig
from moireaug.evaluation.suites.scenes import other_scenes
from tests.training.tiny_suites import cells, configured, folder_of, record_files, suite
from training.attack import protocol as attacking
from training.attack.protocol import SuiteAttack, protocol_of
from training.attack.subject import subject_of_weights
from training.data.load import load
from training.models import classifiers as models
from training.report.published import read_published
from training.report.suite_view import CONTROL_COLUMNS
from training.suites import GROUPS, threat_scenes

pytestmark = pytest.mark.usefixtures("as_the_command_is")


@pytest.fixture(scope="module")
def whole(weights, tmp_path_factory):
    """The suite of all, with a target that is at hand and one that is not, and with one
    display and two cameras alone: (its metrics, its folder)."""
    runs = tmp_path_factory.mktemp("runs")
    with warnings.catch_warnings(action="ignore"), pytest.MonkeyPatch.context() as patch:
        pairs = threat_scenes.DISPLAY_CAMERA_PAIRS[:2]
        patch.setattr(threat_scenes, "DISPLAY_CAMERA_PAIRS", pairs)
        display, _ = pairs[0]
        patch.setattr(threat_scenes, "DISPLAYS", {display: threat_scenes.DISPLAYS[display]})
        targets = f"targets={{small_resnet: {weights}, resnet34: null}}"
        found = suite("paper", weights, runs, targets, "reattack.n=3")
    return found, folder_of(runs, "paper", 3)


def test_the_paper_suite_has_every_table(whole):
    metrics, _ = whole
    assert list(metrics["tables"]) == list(GROUPS["paper"])
    found = cells(metrics)
    for key, cell in found.items():
        pooled = 8 if key[2].startswith("all") else 1
        assert cell["n"] == 3 * pooled and cell["counted"] <= cell["n"], key
        assert 0 <= cell["low"] <= (cell["success"] or 0) <= cell["high"] <= 1
        assert len(cell["outcomes"]) == cell["n"]
    for name in GROUPS["paper"]:
        columns = {c for n, _, c in found if n == name}
        assert columns & {*CONTROL_COLUMNS, "all_no_moire"}, name
    known = {tuple(line[:3]): line[3] for line in read_published().itertuples(index=False)}
    beside = known.keys() & found.keys()
    assert len(beside) > 50 and all(found[key]["paper"] == known[key] for key in beside)
    assert ("transfer", "small_resnet", "ma") in found
    assert ("transfer", "resnet34", "ma") not in found


def test_a_group_is_one_report(whole, weights):
    runs = whole[1].parents[3]
    found = suite("recipes", weights, runs, "reattack.n=3")
    assert list(found["tables"]) == list(GROUPS["recipes"])
    folder = folder_of(runs, "recipes", 3)
    page, text = (folder / "report.html").read_text(), (folder / "tables.md").read_text()
    for title in ("The worst of the attackers", "Natural moiré in other scenes"):
        assert title in page
    assert "| own scene |" in text and "nan" not in text
    # the attackers and controls of one bound, and the scenes
    scene_count = 1 + len(other_scenes(SuiteConfig(scene="screen_photo")))
    assert page.count('<div class="cell"') == 6 + scene_count


def test_the_worst_case_is_the_worst_of_its_row(whole):
    rows = whole[0]["tables"]["adaptive"]
    for name in {r["row"] for r in rows}:
        rates = {
            r["column"]: r["success"] for r in rows if r["row"] == name and r["column"] != "clean"
        }
        assert rates.pop("worst") >= max(rates.values())


def test_every_form_of_the_tables_is_written(whole):
    metrics, folder = whole
    assert {p.suffix for p in folder.iterdir()} == {".html", ".json", ".md", ".csv"}
    page = (folder / "report.html").read_text()
    assert "Resnet34: weights not at hand" in page and "Can it be trusted?" in page
    assert page.index("the photo alone fools") < page.index("(paper, table 1)</h2>")
    with (folder / "results.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    wanted = "table row column condition eps steps success low high accuracy paper psnr"
    assert lines[0].keys() >= set(wanted.split()) and len(lines) == len(cells(metrics))
    assert {line["table"] for line in lines} == set(GROUPS["paper"])
    words = (folder / "tables.md").read_text()
    assert words.count("\n## ") == len(GROUPS["paper"]) + 1
    assert "| resnet34 | – |" in words and "nan" not in words
    assert json.loads((folder / "metrics.json").read_text())["trust"] == metrics["trust"]
    assert len(metrics["trust"]) == 10 and metrics["trust_n"] == 3


def test_another_suite_takes_what_is_there(whole, weights):
    runs = whole[1].parents[3]
    before = [file.read_bytes() for file in record_files(runs)]
    again = suite("jpeg", weights, runs, "reattack.n=3")
    assert cells(again) == {key: cell for key, cell in cells(whole[0]).items() if key[0] == "jpeg"}
    assert [file.read_bytes() for file in record_files(runs)] == before
    page = (folder_of(runs, "jpeg", 3) / "report.html").read_text()
    assert page.count('<div class="cell"') == 8  # the other suite's pictures are shown again


def test_every_protocol_has_a_folder_of_its_own(weights, tmp_path):
    """A smoke test leaves the report of a long evaluation alone."""
    given = {"model": "small_resnet", "weights": weights, "runs": tmp_path, "suite": "jpeg"}
    folders = set()
    for change in ("n=6", "n=2", "steps=2", "seed=5", "eps=[0.01]"):
        cfg = configured(*(f"{k}={v}" for k, v in given.items()), f"reattack.{change}")
        folders.add(subject_of_weights(cfg).folder)
    assert len(folders) == 5


def suite_attack(name, weights, records, *given):
    cfg = configured("model=small_resnet", f"weights={weights}", *given)
    model = models.as_model(cfg.model, 16, cfg.weights, whole=True)
    return SuiteAttack(model, name, protocol_of(cfg, load(cfg.data)), records)


def test_the_checks_take_the_images_asked_for(weights, tmp_path, monkeypatch):
    """With another suite they take no more than they need."""
    monkeypatch.setattr(attacking, "MAX_CHECKED_IMAGES", 2)
    given = ("reattack.n=4", "reattack.batch_size=2")
    found = suite("appearance", weights, tmp_path, *given)
    assert found["n"] == 4 and found["trust_n"] == 2 and len(found["trust"]) == 10
    assert len(suite_attack("trust", weights, tmp_path, *given).checked_batches) == 2


def test_records_that_are_missing_are_not_passed_over(weights, tmp_path):
    """Of two processes one alone has run."""
    attack = suite_attack("success", weights, tmp_path)
    attack.run("one of two", rank=0, world=2)
    with pytest.raises(ValueError, match=r"\d+ of \d+ records are missing"):
        attack.results()
