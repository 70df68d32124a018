"""The tables of a suite, as reports show them: beside the paper's figures, in words, in HTML and in
Markdown."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
import torch
from torch import nn

from moireaug import Scene
from moireaug.defenses.demoire import Demoire
from moireaug.evaluation import images_frame, rates
from moireaug.evaluation.frame import CELL_COLUMNS
from tests.evaluation.conftest import classifier
from tests.evaluation.haze import cell_of, ran
from tests.training.report.conftest import suite_metrics
from training import report
from training.attack.suite_config import PAPER_TARGETS
from training.report.page import render
from training.report.published import read_published, with_paper
from training.report.suite_tables import note_of, pictured_cells, table_texts
from training.report.suite_view import suite_view
from training.suites import SUITES, tables_of
from training.suites.config import PaperConfig

CONFIG = PaperConfig(scene=Scene.preset("screen_photo"), steps=2)


@pytest.fixture(scope="module")
def measured():
    """The suite of recipes on four images: (its tables, its rates)."""
    model = classifier().eval()
    images = torch.rand(4, 3, 16, 16, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        batches = [(images, model(images).argmax(1))]
    tables = tables_of("recipes", CONFIG)
    frame = images_frame(tables, ran((model, batches), tables, scene=CONFIG.scene), (0,))
    return tables, with_paper(rates(frame), CONFIG.middle)


def test_every_published_figure_has_a_cell():
    none = nn.Identity()
    config = dataclasses.replace(
        CONFIG,
        targets=dict.fromkeys(PAPER_TARGETS, none),
        defences={**CONFIG.defences, "quilting": none},
        networks=dict.fromkeys(("mopnet", "mddm", "fhde2net", "amnet"), none),
    )
    cells = set()
    for table in tables_of("paper", config):
        cells |= {(table.name, cell.row, cell.column) for cell in table.cells}
    published = read_published()
    assert len(published) == 135 and published["paper"].between(0, 1).all()
    assert not set(published[CELL_COLUMNS].itertuples(index=False, name=None)) - cells


def test_every_table_has_a_text_whose_note_and_pictures_are_of_it():
    shown = {}
    assert table_texts().keys() == SUITES.keys() - {"trust"}
    for name, text in table_texts().items():
        (table,) = tables_of(name, CONFIG)
        assert text.title and text.corner
        assert bool(note_of(table, suite_metrics())) == bool(text.note)
        cells = pictured_cells(table, CONFIG.middle)
        assert bool(cells) == bool(text.pictures), name
        shown[name] = [cell.place for cell in cells]
        assert text.moire is None or {text.moire[k] for k in ("photo", "plain")} <= {*table.columns}
    assert len(shown["threat"]) == 4 + 8
    assert [row for row, _ in shown["ladder"]] == ["clean", "moire", "ma_4"]
    assert {row for row, _ in shown["success"]} == {"eps_4"}
    assert ("eps_4", "scene") in shown["standard"] and ("eps_4", "worst") not in shown["standard"]


@pytest.mark.parametrize(("scene", "turns"), [("screen_photo", True), ("paper_code", False)])
def test_a_note_says_where_no_attacker_turns_the_camera(scene, turns):
    (table,) = tables_of("standard", PaperConfig(scene=scene))
    told = note_of(table, suite_metrics())
    assert ("No attacker varies pose and panel" in told) != turns and "100 queries" in told


def published_of(table, eps=CONFIG.middle):
    """The paper's figures beside a table that was not measured."""
    cells = [(table.name, cell.row, cell.column, None) for cell in table.cells]
    return with_paper(pd.DataFrame(cells, columns=[*CELL_COLUMNS, "paper"]), eps)


def test_the_papers_figures_stand_beside_its_own_bound_alone():
    for eps, wanted in ((4 / 255, 0.857), (16 / 255, None)):
        (table,) = tables_of("noise_position", dataclasses.replace(CONFIG, eps=(eps,)))
        told = published_of(table, eps)
        assert told["paper"].notna().any() == (wanted is not None)
        assert wanted in (None, cell_of(told, "jpeg_20", "moire_bim")["paper"])


def test_the_papers_figures_stand_beside_its_networks():
    networks = {name: Demoire(nn.Identity()) for name in ("mddm", "smooth")}
    (table,) = tables_of("demoireing", dataclasses.replace(CONFIG, networks=networks))
    told = published_of(table)
    assert cell_of(told, "mddm", "ma")["paper"] == 0.997
    assert cell_of(told, "undefended", "ma_8")["paper"] == 1
    assert np.isnan(cell_of(told, "smooth", "ma")["paper"])


def test_the_tables_say_what_they_show(measured):
    tables, lines = measured
    metrics = suite_metrics(scene_name="screen_photo")
    view = suite_view(metrics, tables, lines, {})
    worst, unseen = view["tables"]
    assert worst["natural"] is None and unseen["verdict"] is None
    assert worst["verdict"]["attack"] == cell_of(lines, "eps_4", "worst")["success"]
    assert len(view["paragraphs"]) == 2  # one of each table
    told = render("suite.md.j2", suite=view, metrics=metrics)
    assert "without subpixels: median" in told and "codes RMS" in told
    assert "| own scene |" in told and ", screen_photo;" in told and "nan" not in told


def test_names_are_escaped_once(measured, tmp_path):
    evil = "a&b<i>"
    names = dict.fromkeys(("model", "suite", "data", "scene_name", "command", "plan"), evil)
    metrics = suite_metrics(**names, trust=[{"name": evil, "verdict": "fail", "says": evil}])
    report.write_suite(tmp_path, metrics, *measured, {})
    page = (tmp_path / "report.html").read_text("utf-8")
    assert "<i>b" not in page and "b<i>" not in page and "&amp;amp;" not in page
    assert page.count("a&amp;b&lt;i&gt;") >= 8


def test_lpips_is_a_column_where_it_was_measured(measured, tmp_path):
    tables, lines = measured
    for name, own in (("without", lines), ("with", lines.assign(lpips=lines["psnr"] / 1000))):
        report.write_suite(tmp_path / name, suite_metrics(), tables, own, {})
        for file in ("report.html", "tables.md", "results.csv"):
            text = (tmp_path / name / file).read_text("utf-8")
            assert ("lpips" in text.lower()) == (name == "with"), (name, file)
    rows = (tmp_path / "with/tables.md").read_text("utf-8").splitlines()
    (head,) = [i for i, row in enumerate(rows) if row.endswith("CIEDE2000 | LPIPS |")]
    assert rows[head + 1] == "|---" * 7 + "|" and rows[head + 2].count("|") == 8
