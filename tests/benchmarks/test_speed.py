"""What the rows of speed and memory are measured on, and where those of some groups alone go."""

import json
import sys

import pytest

from benchmarks import panels, speed
from benchmarks.rows import Row


def test_panels_are_lit_as_their_rows_say():
    plain, scenes = panels.black_matrices((0.35, 0.9))
    for scene in (plain, *scenes.values()):
        assert scene.panel.lit_x == scene.panel.lit_y == 1
    assert plain.panel.lit == 1
    assert {name: scene.panel.lit for name, scene in scenes.items()} == {
        "expose, rgb_stripe, lit 0.35": 0.35,
        "expose, rgb_stripe, lit 0.9": 0.9,
        "expose, pentile, lit 0.35": 0.35,
        "expose, pentile, lit 0.9": 0.9,
    }


def run(monkeypatch, folder, word):
    """Run the command with `--only`, and a group that takes no time."""

    def panels(size):
        yield Row("a row", 1.0, 1.0, 1.0, "ms")

    monkeypatch.setattr(speed, "GROUPS", (panels,))
    given = ["--quick", "--threads", "1", "--out", str(folder), "--only", word]
    monkeypatch.setattr(sys, "argv", ["speed.py", *given])
    speed.main()


def test_some_groups_leave_the_results_of_all_alone(monkeypatch, tmp_path):
    whole = tmp_path / "speed.json"
    whole.write_text("all of them")
    run(monkeypatch, tmp_path, "pan")
    assert whole.read_text() == "all of them"
    written = json.loads((tmp_path / "speed-pan.json").read_text())
    assert [row["what"] for row in written["rows"]] == ["a row"]


def test_a_word_that_leaves_nothing_to_measure_is_refused(monkeypatch, tmp_path, capsys):
    with pytest.raises(SystemExit):
        run(monkeypatch, tmp_path, "panelss")
    assert "--only panelss leaves nothing to measure. Name a part" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
