"""Every benchmark runs in its quick form, one of them as a user would run it. No time is
asserted."""

import json
import math
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from benchmarks import accuracy_vs_time, attack_budget, checkouts, effects_cost, measure, released
from benchmarks.colour import ciede2000, visible_difference
from benchmarks.runs import WITHOUT
from moireaug import Lens, Panel, Scene, Sensor, View, capture, expose
from moireaug.scene.presets import PRESETS

ROOT = Path(__file__).resolve().parents[2]
QUICKLY = ["--quick", "--threads", "1", "--out", "."]
FACTS = {
    "date",
    "device",
    "cpu",
    "cores",
    "threads",
    "load_average_at_start",
    "python",
    *measure.LIBRARIES,
}


@pytest.fixture
def ran(tmp_path, monkeypatch, capsys):
    """Run a script in this process: what it printed, what it wrote, and where."""

    def run(name):
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", [f"{name}.py", *QUICKLY])
        runpy.run_path(str(ROOT / f"benchmarks/{name}.py"), run_name="__main__")
        return capsys.readouterr().out, results(tmp_path, name), tmp_path

    return run


def results(folder, name):
    found = json.loads((folder / f"{name}.json").read_text())
    assert found["metadata"].keys() - {"before"} == FACTS  # the machine is named
    return found


def test_accuracy_vs_time(ran):
    out, written, folder = ran("accuracy_vs_time")
    assert (folder / "accuracy_vs_time.png").stat().st_size > 10_000
    for problem in written["problems"]:
        rows = {row["method"]: row for row in problem["rows"]}
        again = {f"reference {name}" for name in rows if name.startswith("spectral")}
        assert rows.keys() == {*accuracy_vs_time.METHODS, *again, WITHOUT} and len(again) == 3
        for name in again:  # two executions of one method
            same = rows[name.removeprefix("reference ")]
            assert same["by"] == "engine" and rows[name]["by"] == "reference"
            assert rows[name]["rmse_percent"] == pytest.approx(same["rmse_percent"], abs=0.1)
        assert {"seconds", "rmse_percent", "max_percent", "delta_e", "samples", "frontier"} <= rows[
            "auto"
        ].keys()
        assert rows["supersample:8"]["samples"] == 64
        brute = problem["brute_force"]
        assert 0 < brute["error_left_percent"] < brute["difference_to_half_percent"] < 15
        assert rows["supersample:8"]["rmse_percent"] < rows["supersample:2"]["rmse_percent"]
        assert rows["auto"]["rmse_percent"] < rows["point"]["rmse_percent"] / 5
        assert {"chosen", "beaten_by", "times_as_fast"} <= problem["auto"].keys()
        assert problem["auto"]["within"] == (
            rows["auto"]["rmse_percent"] <= math.hypot(1, brute["error_left_percent"])
        )
        assert (
            rows["auto"]["rmse_percent"]
            < rows[WITHOUT]["rmse_percent"] / (1 if "grey" in problem["title"] else 2) + 1e-3
        )
        without = rows[WITHOUT]["seconds"]["median"]
        assert problem["auto"]["over_without"] == pytest.approx(
            rows["auto"]["seconds"]["median"] / without
        )
        assert f"{problem['title']};" in out
    assert (
        out.count("order seen") == len(written["problems"]) and "and is on the frontier of" in out
    )


def test_effects_cost(ran):
    out, written, _ = ran("effects_cost")
    effects = {row["effect"]: row for row in written["default_photo"]["effects"]}
    assert effects.keys() == {*effects_cost.WITHOUT, *effects_cost.WITH, *effects_cost.ALWAYS}
    whole = written["default_photo"]["seconds"]["engine"]["median"]
    assert effects["pose"]["share"] == pytest.approx(effects["pose"]["engine"] / whole)
    assert effects["denoise bilateral"]["run_by"] == "expose and develop"
    assert effects["jpeg"]["run_by"] == "expose and develop"
    assert len(written["presets"]) == effects_cost.QUICK["presets"]
    for name, rows in written["presets"].items():
        plan = Scene.preset(name).plan()
        assert (
            rows[-1]["effects"] == [step.name for step in plan]
            and rows[-1]["exposure"] == plan.exposure
        )
    assert "develop.registered False" in out and "demosaic bilinear" in out


@pytest.mark.parametrize("name", effects_cost.WITHOUT)
def test_the_default_photo_has_what_is_left_out(name):
    """All of it in the plan, nothing of it without; `saturate` goes with a gain that cannot exceed
    the full well."""
    whole = Scene.preset(effects_cost.DEFAULT)
    bare = effects_cost.changed(whole, effects_cost.WITHOUT[name])
    for effect in name.split(", "):
        assert effect in whole.plan() and effect not in bare.plan()


@pytest.mark.parametrize("name", effects_cost.WITH)
def test_what_is_added_is_not_in_the_default_photo(name):
    whole = Scene.preset(effects_cost.DEFAULT)
    more = effects_cost.changed(whole, effects_cost.WITH[name])
    assert str(more.plan()) != str(whole.plan())
    # else it is another kind of one that is there
    if name in {step.name for step in whole.plan().steps}:
        assert name in more.plan() and name not in whole.plan()


def test_speed(ran):
    out, written, _ = ran("speed")
    barred = [row for row in written["rows"] if row["bar"] is not None and "GPU" not in row["what"]]
    assert len(barred) == 13 and all(row["met"] in (True, False) for row in barred)
    assert not any("older checkout" in row["against"] for row in written["rows"])
    assert "Without --before DIR" in out and written["metadata"]["before"] is None
    for row in written["rows"]:
        assert (
            row["what"] in out
            and row["value"] >= 0
            and {"low", "high", "unit", "ratio"} <= row.keys()
        )
        assert row["met"] == (row["ratio"] <= row["bar"] if row["bar"] else None)


def test_training_steps(ran):
    out, written, _ = ran("training_steps")
    rows = {row["recipe"]: row for row in written["recipes"]}
    assert rows.keys() == {p.stem for p in (ROOT / "recipes").glob("*.yaml")}
    assert rows["clean"]["relative"] == 1 and rows["clean"]["passes"] == 1
    assert rows["moire_at"]["passes"] == 2.0 and rows["moire_at"]["relative"] > 0
    assert {row["option"] for row in written["options"]} >= {
        "as it is",
        "train.channels_last=false",
    }
    assert all(row["loaded"] > 0 and row["share"] > 0 for row in written["loading"])
    assert "images/s loaded" in out


def test_attack_budget(ran):
    out, written, folder = ran("attack_budget")
    assert (folder / "attack_budget.png").stat().st_size > 10_000
    (rows,) = written["results"].values()
    assert {(row["attacker"], row["steps"]) for row in rows} == {
        (name, steps)
        for steps in attack_budget.QUICK["steps"]
        for name in attack_budget.attackers(1)
    }
    assert all(0 <= row["accuracy"] <= 1 and row["seconds_per_image"] > 0 for row in rows)
    (best,) = written["recommended"].values()
    assert (
        best["accuracy"] <= min(row["accuracy"] for row in rows) + 0.25 + 1e-9
    )  # an image of four
    assert f"Cheapest within a point of the lowest accuracy: {best['attacker']}" in out


def test_synthesis(tmp_path):
    """By the command."""
    command = [sys.executable, str(ROOT / "benchmarks/synthesis.py"), *QUICKLY]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    out, written = done.stdout, results(tmp_path, "synthesis")
    rows = written["rows"]
    encodings = {(row["encoding"], row["quality"]) for row in rows}
    assert encodings == {("png", None), ("webp", None), ("webp", 90), ("jpeg", 95)}
    for row in rows:
        parts = [row[name]["mean"] for name in ("make", "encode", "write")]
        assert all(part >= 0 for part in parts) and row["make"]["mean"] > 0
        assert row["whole"]["mean"] == pytest.approx(sum(parts))
    # three pictures where there were two
    assert {row["twin"] for row in rows} == {False, True}
    for one, three in zip(rows[:4], rows[4:], strict=True):
        assert three["bytes"] > one["bytes"]
    assert "a million of them" in out


def test_the_recommended_budget_is_the_cheapest_that_is_near():
    rows = [
        {"attacker": "quick", "steps": 1, "accuracy": 0.5, "n": 100, "seconds_per_image": 1.0},
        {"attacker": "near", "steps": 5, "accuracy": 0.31, "n": 100, "seconds_per_image": 2.0},
        {"attacker": "best", "steps": 50, "accuracy": 0.30, "n": 100, "seconds_per_image": 9.0},
    ]
    assert attack_budget.recommended(rows)["attacker"] == "near"
    assert attack_budget.recommended([rows[0], rows[2]])["attacker"] == "best"


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_is_built_up_whole(name):
    *_, (added, last) = effects_cost.growing(Scene.preset(name))
    assert last == Scene.preset(name) and len(added) == 1


@pytest.mark.parametrize("name", PRESETS)
def test_a_scene_reaches_another_checkout_whole(name):
    scene = Scene.preset(name)
    told = checkouts.plain(scene)
    assert Scene.from_dict(told) == scene and "olpf" not in told["lens"]


def test_a_checkout_measures_its_own_code_alone(tmp_path):
    with pytest.raises(RuntimeError, match="no moireaug of its own"):
        checkouts.Checkout(tmp_path, threads=1)


def test_the_plain_chain_is_the_capture():
    scene, image = Scene.preset("paper_code"), torch.rand(1, 3, 21, 21, dtype=torch.float64)
    shot = scene.sample(1, (21, 21))
    assert (released.photograph(image, shot.matrix()) - capture(image, shot)).abs().max() < 1e-6


# Sharma, Wu and Dalal (2005), table 1
PAIRS = [
    ((50, 2.6772, -79.7751), (50, 0, -82.7485), 2.0425),
    ((50, 3.1571, -77.2803), (50, 0, -82.7485), 2.8615),
    ((50, -1.3802, -84.2814), (50, 0, -82.7485), 1.0),
    ((50, 0, 0), (50, -1, 2), 2.3669),
    ((50, 2.49, -0.001), (50, -2.49, 0.0009), 7.1792),
    ((50, 2.49, -0.001), (50, -2.49, 0.0011), 7.2195),
    ((50, -0.001, 2.49), (50, 0.0009, -2.49), 4.8045),
    ((50, 2.5, 0), (50, 0, -2.5), 4.3065),
    ((50, 2.5, 0), (73, 25, -18), 27.1492),
    ((50, 2.5, 0), (50, 3.1736, 0.5854), 1.0),
    ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
    ((22.7233, 20.0904, -46.6940), (23.0331, 14.9730, -42.5619), 2.0373),
    ((2.0776, 0.0795, -1.1350), (0.9033, -0.0636, -0.5514), 0.9082),
]


@pytest.mark.parametrize(("first", "second", "expected"), PAIRS)
def test_ciede2000_is_as_published(first, second, expected):
    a, b = (torch.tensor([lab], dtype=torch.float64) for lab in (first, second))
    assert ciede2000(a, b).item() == pytest.approx(expected, abs=5e-5)
    assert ciede2000(b, a).item() == pytest.approx(expected, abs=5e-5)
    assert ciede2000(a, a).item() == 0


def test_black_and_white_are_a_hundred_apart():
    black, white = torch.zeros(1, 3, 2, 2), torch.ones(1, 3, 2, 2)
    assert visible_difference(black, white).shape == (1, 2, 2)
    assert torch.allclose(visible_difference(black, white), torch.tensor(100.0), atol=0.01)


@pytest.mark.parametrize(
    ("points", "kept"),
    [
        ([], []),
        ([(1, 1)], [0]),
        ([(2, 1), (1, 2)], [1, 0]),
        ([(1, 2), (2, 2), (3, 1), (2, 3)], [0, 2]),
        ([(1, 1), (1, 1), (1, 0.5)], [2]),
    ],
)
def test_frontier(points, kept):
    assert measure.frontier(points) == kept


def row(method, seconds, error):
    return {
        "method": method, "plan": method, "rmse_percent": error,
        "seconds": {"median": seconds, "low": seconds * 0.9, "high": seconds * 1.1},
    }  # fmt: skip


# rows beside auto's 1 s and 2 %; what beats it; its rival; whether that is as accurate; times as
# fast
JUDGED = [
    ([row("supersample:2", 2, 9), row("supersample:4", 8, 1)], [], "supersample:4", True, 8),
    ([row("supersample:2", 2, 9), row("supersample:4", 8, 5)], [], "supersample:4", False, 8),
    ([row("supersample:2", 3, 1), row("box", 0.5, 1)], ["box"], "supersample:2", True, 3),
    ([row("supersample:2", 3, 1), row("box", 0.95, 1)], [], "supersample:2", True, 3),
    ([row("supersample:2", 3, 1), row("box", 0.5, 1.99)], [], "supersample:2", True, 3),
]


@pytest.mark.parametrize(("others", "beaten_by", "rival", "able", "times"), JUDGED)
def test_auto_is_judged_beyond_noise(others, beaten_by, rival, able, times):
    found = accuracy_vs_time.judge([*others, row("auto", 1, 2)], floor=0.5)
    assert found["beaten_by"] == beaten_by and found["rival"] == rival
    assert found["rival_is_as_accurate"] == able and found["times_as_fast"] == pytest.approx(times)


def test_the_reference_says_how_far_it_is_off():
    """Against sixteen times as many points."""
    scene = Scene(
        panel=Panel(scale=1.4), view=View(roll=5), lens=Lens(blur=0.3), sensor=Sensor(scale=2)
    )
    image = torch.rand(1, 3, 12, 12, dtype=torch.float64)
    reading, told = accuracy_vs_time.converged(scene, image, 8)
    shot = accuracy_vs_time.draw(accuracy_vs_time.with_method(scene, "supersample:32"), image)
    off = accuracy_vs_time.rms(reading - expose(image, shot), reading)
    assert 0.4 * told["error_left_percent"] < off < 2 * told["error_left_percent"]


def test_candidates_take_turns_and_slow_ones_sit_out():
    seen = []
    calls = {"a": lambda: seen.append("a"), "b": lambda: seen.append("b")}
    times = measure.timed_together(calls, repeats=5, warmup=1, budget=0.0)
    assert seen[:2] == ["a", "b"] and seen.count("a") == seen.count("b") == 1 + measure.FEWEST
    assert (
        times["a"].runs == measure.FEWEST and times["a"].low <= times["a"].median <= times["a"].high
    )


def test_a_table_is_aligned():
    assert (
        measure.table(("a", "b"), [("x", 1.5), ("yy", 12345.0)])
        == "a       b\n--  -----\nx     1.5\nyy  12345"
    )
