"""Every benchmark runs in its quick form, one of them as a user would run it. No time is
asserted."""

import contextlib
import importlib
import itertools
import json
import math
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from benchmarks import (
    accuracy_vs_time,
    apart,
    attack_budget,
    bins,
    checkouts,
    effects_cost,
    other_libraries,
    rejecting,
    training_steps,
)
from benchmarks.runs import WITHOUT
from moireaug import Scene, engine, evaluation
from moireaug.defenses import Rejecting

ROOT = Path(__file__).resolve().parents[2]
QUICKLY = ["--quick", "--threads", "1", "--out", "."]


def test_a_script_finds_the_repository_from_anywhere():
    own_import = re.compile(r"^(from|import) (benchmarks|training|moireaug)\b", re.MULTILINE)
    for file in ROOT.glob("benchmarks/*.py"):
        text = file.read_text("utf-8")
        if '__name__ == "__main__"' in text:
            before, found, _ = text.partition("\nsys.path")
            assert found and not own_import.search(before), file.name


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
    return json.loads((folder / f"{name}.json").read_text())


def test_accuracy_vs_time(ran):
    out, written, folder = ran("accuracy_vs_time")
    assert (folder / "accuracy_vs_time.png").is_file()
    for problem in written["problems"]:
        rows = {row["method"]: row for row in problem["rows"]}
        error = {name: row["rmse_percent"] for name, row in rows.items()}
        again = [name for name in rows if name.startswith("reference ")]
        assert rows.keys() == {*accuracy_vs_time.METHODS, *again, WITHOUT} and len(again) == 3
        for name in again:  # two executions of one method
            same = name.removeprefix("reference ")
            assert rows[same]["by"] == "engine" and rows[name]["by"] == "reference"
            assert error[name] == pytest.approx(error[same], abs=0.1)
        brute = problem["brute_force"]
        assert 0 < brute["error_left_percent"] < brute["difference_to_half_percent"] < 15
        assert rows["supersample:8"]["samples"] == 64
        assert error["supersample:8"] < error["supersample:2"]
        assert error["auto"] < error["point"] / 5
        beaten = 1 if "grey" in problem["title"] else 2
        assert error["auto"] < error[WITHOUT] / beaten + 1e-3
        within = error["auto"] <= math.hypot(1, brute["error_left_percent"])
        assert problem["auto"]["within"] == within
        slower = rows["auto"]["seconds"]["median"] / rows[WITHOUT]["seconds"]["median"]
        assert problem["auto"]["over_without"] == pytest.approx(slower)
        assert f"{problem['title']};" in out


def test_bins(ran):
    _, written, folder = ran("bins")
    assert (folder / "bins.png").is_file()
    rows = written["rows"]
    assert len(rows) == 2 * 2 * 2 * len(bins.TOLERANCES)
    for row in rows:
        assert 0 < row["binned_error"] < row["moire"]
        assert row["full_error"] < 0.01 * row["moire"]  # it differs by its tolerance alone
        assert row["times_as_fast"] == pytest.approx(row["full_ms"] / row["binned_ms"])


def test_effects_cost(ran):
    _, written, _ = ran("effects_cost")
    effects = {row["effect"]: row for row in written["default_photo"]["effects"]}
    assert effects.keys() == {*effects_cost.WITHOUT, *effects_cost.WITH, *effects_cost.ALWAYS}
    whole = written["default_photo"]["seconds"]["median"]
    assert effects["pose"]["share"] == pytest.approx(effects["pose"]["seconds"] / whole)
    assert effects["jpeg"]["run_by"] == "expose and develop; reference from 'jpeg' on"


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
    assert sum(row["bar"] is not None for row in written["rows"]) == 15
    assert not any("older checkout" in row["against"] for row in written["rows"])
    assert written["metadata"]["before"] is None
    for row in written["rows"]:
        assert row["what"] in out
        assert row["value"] >= 0 or "above" in row["what"]  # a difference of two times
        assert row["met"] == (row["ratio"] <= row["bar"] if row["bar"] else None)


def test_training_steps(ran):
    _, written, _ = ran("training_steps")
    rows = {row["recipe"]: row for row in written["recipes"]}
    assert rows.keys() == {p.stem for p in (ROOT / "recipes").glob("*.yaml")}
    assert rows["clean"]["relative"] == 1 and rows["clean"]["passes"] == 1
    assert rows["moire_at"]["passes"] == 2.875 and rows["moire_at"]["relative"] > 0
    assert all(row["loaded"] > 0 and row["share"] > 0 for row in written["loading"])
    read = [(row["read_from"], row["workers"]) for row in written["loading"]]
    assert read == list(training_steps.READ)


def test_gpu(ran):
    """On the CPU, where there is no GPU."""
    _, written, _ = ran("gpu")
    for group in ("photos", "stages", "attacks", "training"):
        assert written[group] and all(row["seconds"]["median"] > 0 for row in written[group])
    shares = {row["what"]: row["camera_share"] for row in written["training"]}
    assert shares["small_resnet, plain"] is None and shares["small_resnet, moire_at"] < 1


def test_attack_budget(ran):
    out, written, folder = ran("attack_budget")
    assert (folder / "attack_budget.png").is_file()
    (rows,) = written["results"].values()
    steps, names = attack_budget.QUICK["steps"], attack_budget.attackers(1)
    wanted = set(itertools.product(names, steps))
    assert {(row["attacker"], row["steps"]) for row in rows} == wanted
    assert all(0 <= row["accuracy"] <= 1 and row["seconds_per_image"] > 0 for row in rows)
    (best,) = written["recommended"].values()
    lowest = min(row["accuracy"] for row in rows)
    assert best["accuracy"] <= lowest + 0.25 + 1e-9  # an image of four
    assert f"Cheapest within a point of the lowest accuracy: {best['attacker']}" in out


def test_synthesis(tmp_path):
    """By the command."""
    command = [sys.executable, str(ROOT / "benchmarks/synthesis.py"), *QUICKLY]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    rows = results(tmp_path, "synthesis")["rows"]
    encodings = {(row["encoding"], row["quality"]) for row in rows}
    assert encodings == {("png", None), ("webp", None), ("webp", 90), ("jpeg", 95)}
    for row in rows:
        parts = [row[name]["mean"] for name in ("make", "encode", "write")]
        assert row["whole"]["mean"] == pytest.approx(sum(parts))
    # three pictures where there were two
    assert [row["twin"] for row in rows] == [False] * 4 + [True] * 4
    for one, three in zip(rows[:4], rows[4:], strict=True):
        assert three["bytes"] > one["bytes"]


def test_the_strength_of_a_wave_is_its_own():
    """Of a sinusoid in green on grey; its period is inside the band."""
    x = torch.arange(64) / 8
    grey = torch.full((2, 3, 64, 64), 0.5)
    waved = grey.clone()
    waved[:, 1] += 0.1 * (2 * torch.pi * x).sin()
    colour, luma = other_libraries.strength(waved, grey)
    wave = 25.5 / 2**0.5  # in codes; R - G and B - G carry it whole, luma a third
    assert colour == pytest.approx(2**0.5 * 3 * luma, rel=1e-3)
    assert 0.4 * wave < luma * 3 < wave
    assert other_libraries.strength(grey, grey) == (0, 0)


def test_a_ridge_regression_tells_few_from_many():
    x = torch.randn(60, 5, generator=torch.Generator().manual_seed(0))
    y = (torch.arange(60) < 10).float()
    x[:, 2] += 8 * y
    scores = other_libraries.ridge(x, y)(x)
    assert scores[:10].min() > scores[10:].max()


def test_rejected_photos_are_neither_fooled_nor_let_through():
    torch.manual_seed(0)
    images, labels = torch.rand(4, 3, 24, 24), torch.zeros(4, dtype=torch.int64)
    detector = rejecting.train_detector(images, [Scene.preset("screen_photo")], 2)
    model = Rejecting(lambda images: images.mean((2, 3)), detector, -1e6)
    frame = evaluation.evaluate(model, [(images, labels)], "ladder", steps=1, progress=False)
    (row, *_) = rejecting.outcome_rows(frame, "knows the detector")
    assert row["rejected"] == 1 and row["fooled"] == 0 and math.isnan(row["accuracy_of_passed"])


def test_a_folder_without_a_run_is_refused_in_a_sentence(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["attack_budget.py", "nowhere"])
    with pytest.raises(SystemExit):
        attack_budget.main()
    assert "nowhere is not a run's folder" in capsys.readouterr().err


def test_the_recommended_budget_is_the_cheapest_that_is_near():
    rows = [
        {"attacker": "quick", "steps": 1, "accuracy": 0.5, "n": 100, "seconds_per_image": 1.0},
        {"attacker": "near", "steps": 5, "accuracy": 0.31, "n": 100, "seconds_per_image": 2.0},
        {"attacker": "best", "steps": 50, "accuracy": 0.30, "n": 100, "seconds_per_image": 9.0},
    ]
    assert attack_budget.recommended(rows)["attacker"] == "near"
    assert attack_budget.recommended([rows[0], rows[2]])["attacker"] == "best"
