"""What the rows of speed and memory are measured on, and where those of some groups alone go."""

import json
import sys

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


def test_one_group_leaves_the_results_of_all_alone(monkeypatch, tmp_path):
    def panels(size):
        yield Row("a row", 1.0, 1.0, 1.0, "ms")

    whole = tmp_path / "speed.json"
    whole.write_text("all of them")
    monkeypatch.setattr(speed, "GROUPS", (panels, speed.executions))
    given = ["--quick", "--threads", "1", "--out", str(tmp_path), "--only", "panels"]
    monkeypatch.setattr(sys, "argv", ["speed.py", *given])
    speed.main()
    assert whole.read_text() == "all of them"
    written = json.loads((tmp_path / "speed-panels.json").read_text())
    assert [row["what"] for row in written["rows"]] == ["a row"]
