"""The recipes through their real commands, small: files, figures, resuming, and sentences for what
goes wrong."""

import json
import shutil
from dataclasses import replace

import pytest

from moireaug.evaluation.identity import identity
from tests.training.forked import Command
from tests.training.small import (
    BRIEF,
    TINY,
    baseline_config,
    configured,
    inside,
    start_config,
)
from training import fit
from training.attack.results import run_metrics, with_baseline
from training.classifier.train import train_model
from training.data import signs
from training.data.load import load
from training.recipe import phases
from training.runs import reuse, trained
from training.runs.run import Run
from training.system import machine
from training.system.files import read_metrics
from training.trainer import ranks

pytestmark = pytest.mark.usefixtures("as_the_command_is")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """One run of the real command: the baseline, the recipe, the report."""
    cwd = tmp_path_factory.mktemp("whole")
    process = Command("fit.py", "recipe=moire_at", *TINY, cwd=cwd)
    said = process.communicate()
    assert process.returncode == 0, said
    return cwd, said


def test_a_run_leaves_what_it_promises(whole):
    cwd, (out, err) = whole
    plain_files = {"metrics.json", "best.ckpt", "last.ckpt", "config.yaml"}
    for recipe, files in (
        ("clean", plain_files),
        ("baseline", plain_files | {"records"}),
        ("moire_at", plain_files | {"records", "report.html"}),
    ):
        folder = cwd / "runs" / recipe / "seed0"
        assert {p.name for p in folder.iterdir()} == files
    m = json.loads((cwd / "runs/moire_at/seed0/metrics.json").read_text())
    about = [m[key] for key in ("recipe", "seed", "data", "model")]
    assert about == ["moire_at", 0, "signs", "attention_convnet"]
    assert m["train"]["epochs"] == 2
    assert m["train"]["seconds"] > 0 and m["train"]["images_per_second"] > 0
    assert m["train"]["passes"] == 2.875 and len(m["train"]["history"]) == 2
    run = trained.read(folder)
    assert m["identity"] == identity(run.model())  # as a later re-attack says it
    assert run.classes == dict(enumerate(signs.CLASSES))
    rows = "clean dimmed no_moire moire random_8 ma_2 ma_4 ma_8 ma_4_targeted pgd_4 worst_4"
    assert [r["name"] for r in m["reattack"]] == rows.split()
    base = {r["name"]: r for r in m["baseline"]["reattack"]}
    for row in m["reattack"]:
        assert set(row) >= {"name", "eps", "targeted", "accuracy", "success", "n", "seconds"}
        assert row["n"] == 24
        gain = row["accuracy"] - base[row["name"]]["accuracy"]
        assert m["gain"][row["name"]] == pytest.approx(gain)
        low, high = m["gain_interval"][row["name"]]
        assert low <= m["gain"][row["name"]] <= high
    assert m["clean_accuracy"] == m["reattack"][0]["accuracy"]
    assert m["baseline"]["recipe"] == "baseline" and m["start"]["recipe"] == "clean"
    printed = out.splitlines()
    assert printed[-1] == "Report: runs/moire_at/seed0/report.html"
    assert any(line.startswith("Moiré Attack 4/255") for line in printed)
    assert sum(line.startswith("training: moire_at ") for line in printed) == 1
    assert sum(line.startswith("Epoch") for line in printed) == 1 + 2 + 2
    once = "moireaug compiles its CPU kernels, once on this machine"
    assert [line for line in err.splitlines() if not line.startswith(once)] == []


def test_the_baseline_trains_as_long_as_the_run(whole):
    cwd, _ = whole
    m = json.loads((cwd / "runs/moire_at/seed0/metrics.json").read_text())
    clean, base = (
        json.loads((cwd / f"runs/{r}/seed0/metrics.json").read_text())
        for r in ("clean", "baseline")
    )
    shared_keys = {"recipe", "seed", "data", "model", "train", "environment"}
    assert set(m["start"]) == shared_keys
    assert set(m["baseline"]) == shared_keys | {"clean_accuracy", "reattack"}
    for ours, theirs in ((m["start"], clean), (m["baseline"], base)):
        assert {key: ours[key] for key in shared_keys} == {key: theirs[key] for key in shared_keys}
    for side, epochs in ((clean, (1, 1)), (base, (2, 3)), (m, (2, 3))):
        assert (side["train"]["epochs"], side["train"]["total_epochs"]) == epochs
    start = clean["train"]["seconds"]
    for side in (base, m):
        assert side["train"]["total_seconds"] == pytest.approx(side["train"]["seconds"] + start)
    assert clean["train"]["total_seconds"] == start
    assert (clean["start"], clean["baseline"], base["baseline"]) == (None, None, None)
    assert base["start"] == m["start"] and base["gain"] == {}
    assert base["train"]["init"] == "clean" and clean["train"]["init"] == "random"


def test_a_plain_run_is_attacked_once_it_is_asked_for(whole, tmp_path, monkeypatch):
    shutil.copytree(whole[0] / "runs", tmp_path / "runs")
    folder = tmp_path / "runs/baseline/seed0"
    before = read_metrics(folder)
    assert "reattack" not in before and set(before["time"]) == {"train"}
    assert "trust" in read_metrics(tmp_path / "runs/moire_at/seed0")
    monkeypatch.setattr(ranks, "fit", lambda *args: pytest.fail("trained again"))
    found = fit.fit(configured("recipe=baseline", *TINY, f"runs={tmp_path / 'runs'}"))
    assert found["trust"] and found["time"]["checks"] > 0 and found["time"]["re-attack"] > 0
    assert (folder / "report.html").is_file()
    kept = read_metrics(folder)
    for metrics in (found, kept):
        for name in ("train", "start", "config", "environment"):
            assert metrics[name] == before[name]
    assert kept["trust"] == found["trust"] and kept["reattack"] == found["reattack"]
    beside = read_metrics(tmp_path / "runs/moire_at/seed0")["baseline"]
    assert kept["reattack"] == beside["reattack"], "what the other run has computed is read"


def test_a_finished_run_is_attacked_in_another_way_and_not_trained_again(
    whole, tmp_path, monkeypatch
):
    shutil.copytree(whole[0] / "runs", tmp_path / "runs")
    folder = tmp_path / "runs/moire_at/seed0"
    weights, before = (folder / "best.ckpt").read_bytes(), read_metrics(folder)
    monkeypatch.setattr(ranks, "fit", lambda *args: pytest.fail("trained again"))
    given = configured("recipe=moire_at", *TINY, *BRIEF, f"runs={tmp_path / 'runs'}")
    assert Run(given).stage() == "trained"
    monkeypatch.setattr(machine, "command", lambda: "this command")
    found = fit.fit(given)
    assert (folder / "best.ckpt").read_bytes() == weights
    assert [p.name for p in folder.parent.iterdir() if p.name[0] != "."] == ["seed0"]
    assert found["reattack"][0]["n"] == found["config"]["reattack"]["n"] == 6
    assert found["command"] == "this command" and found["train"] == before["train"]
    assert Run(given).stage() == "finished" and read_metrics(folder) == found
    assert trained.read(folder).cfg.reattack.n == 6
    start = Run(start_config(given))
    assert start.stage() == "trained", "it was never attacked"
    (start.folder / "best.ckpt").unlink()
    assert start.stage() == "begun"


def test_a_re_attack_takes_what_the_run_has_computed(whole, tmp_path):
    shutil.copytree(whole[0] / "runs", tmp_path / "runs")
    before = {path: path.read_bytes() for path in tmp_path.glob("runs/*/seed0/records/*.jsonl")}
    assert len(before) == 2
    done = inside("reattack.py", "run=runs/moire_at/seed0", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert {path: path.read_bytes() for path in before} == before
    (path,) = tmp_path.glob("runs/moire_at/seed0/reattack/screen_photo-*/ladder/metrics.json")
    again = json.loads(path.read_text())
    m = json.loads((tmp_path / "runs/moire_at/seed0/metrics.json").read_text())
    for name in ("reattack", "gain", "correct", "trust"):
        assert again[name] == m[name]
    assert again["baseline"]["reattack"] == m["baseline"]["reattack"]


def test_the_gain_is_over_the_baseline_not_the_start():
    right, wrong = {"clean": "1" * 8}, {"clean": "0" * 8}
    cfg = configured("recipe=moire_at", *TINY)
    start = replace(run_metrics(cfg, None, None), correct=wrong)
    alone = replace(run_metrics(cfg, None, start.plain()), correct=right)
    for baseline, gain in ((wrong, 1.0), (right, 0.0)):
        ladder = {"clean_accuracy": 0.0, "reattack": [], "correct": baseline}
        m = with_baseline(alone, start.plain(), ladder).to_dict()
        assert m["gain"] == {"clean": gain}
        assert set(m["start"]) == {"recipe", "seed", "data", "model", "train", "environment"}
    assert alone.to_dict()["gain"] == {}


def test_plain_runs_are_reused_only_where_their_settings_fit(whole, capsys):
    cwd, _ = whole
    cfg = configured("recipe=moire_aug", *TINY, f"runs={cwd / 'runs'}", "reattack.n=6")
    folders = [cwd / f"runs/{recipe}/seed0" for recipe in ("clean", "baseline")]
    before = [(folder / "best.ckpt").stat().st_mtime_ns for folder in folders]
    start, baseline = phases.plain_runs(Run(cfg), load(cfg.data))
    assert (start.recipe, baseline.recipe) == ("clean", "baseline")
    assert [(folder / "best.ckpt").stat().st_mtime_ns for folder in folders] == before
    said = capsys.readouterr().out
    assert f"The start is reused from {folders[0]}" in said
    assert f"The baseline is reused from {folders[1]}" in said
    other = configured("recipe=moire_aug", *TINY, "data.train=80", f"runs={cwd / 'runs'}")
    for wanted in (start_config(other), baseline_config(other)):
        assert Run(wanted).stage() == "other"


def test_a_baseline_of_other_settings_is_not_attacked(whole, tmp_path, capsys):
    shutil.copytree(whole[0] / "runs", tmp_path / "runs")
    run = trained.read(tmp_path / "runs/moire_at/seed0")
    assert reuse.read_baseline_of(run).cfg.recipe == "baseline"
    path = tmp_path / "runs/baseline/seed0/config.yaml"
    path.write_text(path.read_text().replace("epochs: 2", "epochs: 3"))
    assert reuse.read_baseline_of(run) is None
    assert "no baseline is attacked beside this run" in capsys.readouterr().out


def test_reattack_of_a_run(whole):
    cwd, _ = whole
    given = ["run=runs/moire_at/seed0", "scene=paper_code", "reattack.n=12", "reattack.eps=[0.02]"]
    done = inside("reattack.py", *given, cwd=cwd)
    assert done.returncode == 0, done.stderr
    (path,) = (cwd / "runs/moire_at/seed0/reattack").glob(
        "paper_code-n12-steps2-*/ladder/metrics.json"
    )
    m = json.loads(path.read_text())
    assert m["scene_name"] == "paper_code" and m["reattack"][0]["n"] == 12
    assert m["baseline"]["recipe"] == "baseline" and m["baseline"]["reattack"][0]["n"] == 12
    assert path.with_name("report.html").is_file()


def test_an_interrupted_start_is_resumed_and_then_its_recipe_begins(tmp_path, capsys):
    cfg = configured("recipe=moire_aug", *TINY, *BRIEF, "train.epochs=1", f"runs={tmp_path}")
    start = start_config(cfg)
    Run(start).prepare()
    train_model(Run(start), load(start.data))
    cfg.resume = True
    metrics = fit.fit(cfg)
    assert "Training is complete: the weights are read from" in capsys.readouterr().out
    assert metrics["recipe"] == "moire_aug" and metrics["baseline"]["recipe"] == "baseline"
    assert metrics["start"]["recipe"] == "clean" and metrics["train"]["total_epochs"] == 2


@pytest.mark.parametrize("damage", ["cut", "noise", "gone"])
def test_a_damaged_checkpoint_gets_a_sentence(damage, whole, tmp_path):
    run = tmp_path / "runs/moire_at/seed0"
    shutil.copytree(whole[0] / "runs/moire_at/seed0", run)
    best = run / "best.ckpt"
    if damage == "gone":
        best.unlink()
    else:
        best.write_bytes(best.read_bytes()[: 5000 if damage == "cut" else 0] + b"\x00" * 64)
    with pytest.raises(ValueError, match=r"is not a run's folder|could not be read"):
        trained.read(run)
