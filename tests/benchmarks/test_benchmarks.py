"""Every benchmark runs in its quick form, one of them as a user would run it. No time is
asserted."""

import contextlib
import importlib
import json
import math
import runpy
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmarks import (
    accuracy_vs_time,
    apart,
    attack_budget,
    bins,
    checkouts,
    effects_cost,
    measure,
    training_steps,
)
from benchmarks.runs import WITHOUT
from moireaug import Scene, engine

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


def test_bins(ran):
    out, written, folder = ran("bins")
    assert (folder / "bins.png").stat().st_size > 10_000
    rows = written["rows"]
    assert len(rows) == 2 * 2 * 2 * len(bins.TOLERANCES)
    for row in rows:
        assert 0 < row["binned_error"] < row["moire"]
        assert row["full_error"] < 0.01 * row["moire"]  # it differs by its tolerance alone
        assert row["times_as_fast"] == pytest.approx(row["full_ms"] / row["binned_ms"])
    for key in ("scale", "pitch", "view", "layout", "tolerance"):
        assert f"\n{key} " in out


def test_effects_cost(ran):
    out, written, _ = ran("effects_cost")
    effects = {row["effect"]: row for row in written["default_photo"]["effects"]}
    assert effects.keys() == {*effects_cost.WITHOUT, *effects_cost.WITH, *effects_cost.ALWAYS}
    whole = written["default_photo"]["seconds"]["engine"]["median"]
    assert effects["pose"]["share"] == pytest.approx(effects["pose"]["engine"] / whole)
    assert effects["pose"]["run_by"] == "expose and develop"
    assert effects["jpeg"]["run_by"] == "expose and develop; reference from 'jpeg' on"
    assert len(written["presets"]) == effects_cost.QUICK["presets"]
    for name, rows in written["presets"].items():
        plan = Scene.preset(name).plan((8, 8))
        assert (
            rows[-1]["effects"] == [step.name for step in plan.called]
            and rows[-1]["exposure"] == plan.exposure
        )
    assert "develop.registered False" in out and "noise of photons" in out


@pytest.fixture
def started(monkeypatch):
    """Run checkouts in this process, and start nothing that imports torch for seconds."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr(sys, "argv", ["worker.py", str(ROOT)])
    worker = importlib.import_module("benchmarks.worker")
    monkeypatch.setattr(worker, "resident_rise", lambda scene, shape: 1.0)

    class Inside(checkouts.Checkout):
        def __init__(self, root, threads, engine=True):
            self.engine = engine

        def ask(self, name, **arguments):
            with contextlib.nullcontext() if self.engine else engine.reference():
                return getattr(worker, name)(**arguments)

        def __exit__(self, *_):
            pass

    monkeypatch.setattr(apart, "Checkout", Inside)
    monkeypatch.setattr(apart, "TORCH", "pass")
    monkeypatch.setattr(apart, "PHOTO", "pass")


def test_speed(started, ran):
    out, written, _ = ran("speed")
    barred = [row for row in written["rows"] if row["bar"] is not None]
    assert len(barred) == 13 and all(row["met"] in (True, False) for row in barred)
    assert not any("older checkout" in row["against"] for row in written["rows"])
    assert "Without --before DIR" in out and written["metadata"]["before"] is None
    for row in written["rows"]:
        assert row["what"] in out and {"low", "high", "unit", "ratio"} <= row.keys()
        assert row["value"] >= 0 or "above" in row["what"]  # a difference of two times
        assert row["met"] == (row["ratio"] <= row["bar"] if row["bar"] else None)


def test_training_steps(ran):
    out, written, _ = ran("training_steps")
    rows = {row["recipe"]: row for row in written["recipes"]}
    assert rows.keys() == {p.stem for p in (ROOT / "recipes").glob("*.yaml")}
    assert rows["clean"]["relative"] == 1 and rows["clean"]["passes"] == 1
    assert rows["moire_at"]["passes"] == 2.875 and rows["moire_at"]["relative"] > 0
    assert {row["option"] for row in written["options"]} >= {
        "as it is",
        "train.channels_last=false",
    }
    assert all(row["loaded"] > 0 and row["share"] > 0 for row in written["loading"])
    read = [(row["read_from"], row["workers"]) for row in written["loading"]]
    assert read == list(training_steps.READ)
    assert "images/s loaded" in out


def test_gpu(ran):
    """On the CPU, where there is no GPU."""
    out, written, _ = ran("gpu")
    for group in ("photos", "stages", "attacks"):
        assert all(row["seconds"]["median"] > 0 for row in written[group])
        assert all(row["what"] in out for row in written[group])
    names = [row["what"] for row in written["photos"]]
    assert names[0] == "kornia RandomJPEG" and "there and back" in names[-1]
    assert len(written["stages"]) == 12 and len(written["attacks"]) == 4


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


def test_two_runs_of_a_recipe_are_two_models(monkeypatch):
    def read(folder):
        cfg = SimpleNamespace(recipe="clean", data=None, reattack=SimpleNamespace(n=0))
        return SimpleNamespace(cfg=cfg, model=lambda: folder)

    monkeypatch.setattr(attack_budget.trained, "read", read)
    monkeypatch.setattr(attack_budget, "load", lambda data: None)
    protocol = SimpleNamespace(batches=[], scene=None)
    monkeypatch.setattr(attack_budget, "protocol_of", lambda cfg, splits: protocol)
    found = attack_budget.models_of(["clean/seed0", "clean/seed1"], 4)
    assert {name: str(model) for name, (model, _, _) in found.items()} == {
        "clean/seed0": "clean/seed0",
        "clean/seed1": "clean/seed1",
    }


def test_a_folder_without_a_run_is_refused_in_a_sentence(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["attack_budget.py", "nowhere"])
    with pytest.raises(SystemExit):
        attack_budget.main()
    assert "nowhere is not a run's folder" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("given", "folder"),
    [([], "results"), (["--quick"], "results/quick"), (["--quick", "--out", "here"], "here")],
)
def test_a_quick_run_replaces_no_published_results(given, folder):
    args = measure.arguments("About.").parse_args(given)
    assert measure.results(args).as_posix().endswith(folder)


def test_the_recommended_budget_is_the_cheapest_that_is_near():
    rows = [
        {"attacker": "quick", "steps": 1, "accuracy": 0.5, "n": 100, "seconds_per_image": 1.0},
        {"attacker": "near", "steps": 5, "accuracy": 0.31, "n": 100, "seconds_per_image": 2.0},
        {"attacker": "best", "steps": 50, "accuracy": 0.30, "n": 100, "seconds_per_image": 9.0},
    ]
    assert attack_budget.recommended(rows)["attacker"] == "near"
    assert attack_budget.recommended([rows[0], rows[2]])["attacker"] == "best"
