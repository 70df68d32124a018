"""The recipes through their real commands, small: files, figures, resuming, and sentences for what
goes wrong."""

import shutil
from dataclasses import replace

import pytest

import moireaug
from moireaug.evaluation.identity import identity_of
from tests.training.forked import Command
from tests.training.small import BRIEF, TINY, configured, inside, train
from training import fit
from training.attack.results import run_metrics, with_baseline
from training.data import signs
from training.data.load import load
from training.recipe import phases
from training.runs import trained
from training.runs.layout import read_metrics
from training.runs.metrics import RunMetrics
from training.runs.run import Run, baseline_of, start_of
from training.system import machine
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


@pytest.fixture
def copied(whole, tmp_path):
    """A copy of its folder of runs."""
    return shutil.copytree(whole[0] / "runs", tmp_path / "runs")


@pytest.fixture
def nothing_trained(monkeypatch):
    monkeypatch.setattr(ranks, "fit", lambda *args: pytest.fail("trained again"))


def test_a_run_leaves_what_it_promises(whole):
    cwd, (out, err) = whole
    plain_files = {"metrics.json", "best.ckpt", "last.ckpt", "config.yaml"}
    for recipe, more in (
        ("clean", set()),
        ("baseline", {"records"}),
        ("moire_at", {"records", "report.html"}),
    ):
        folder = cwd / "runs" / recipe / "seed0"
        assert {p.name for p in folder.iterdir()} == plain_files | more
    m = read_metrics(folder)
    about = [m[key] for key in ("recipe", "seed", "data", "model")]
    assert about == ["moire_at", 0, "signs", "attention_convnet"]
    environment = m["environment"]
    assert (environment["moireaug"], environment["precision"]) == (moireaug.__version__, "32-true")
    cost = m["train"]
    assert cost["epochs"] == 2 and cost["passes"] == 2.875 and len(cost["history"]) == 2
    assert cost["seconds"] > 0 and cost["images_per_second"] > 0
    run = trained.read(folder)
    assert m["identity"] == identity_of(run.model())  # as a later re-attack says it
    assert run.classes == dict(enumerate(signs.CLASSES))
    rows = "clean dimmed no_moire moire random_8 ma_2 ma_4 ma_8 ma_4_targeted pgd_4 worst_4"
    assert [r["name"] for r in m["reattack"]] == rows.split()
    base = {r["name"]: r for r in m["baseline"]["reattack"]}
    for row in m["reattack"]:
        assert row.keys() >= {"eps", "targeted", "success", "seconds"} and row["n"] == 8
        gain = m["gain"][row["name"]]
        assert gain == pytest.approx(row["accuracy"] - base[row["name"]]["accuracy"])
        low, high = m["gain_interval"][row["name"]]
        assert low <= gain <= high
    assert m["clean_accuracy"] == m["reattack"][0]["accuracy"]
    printed = out.splitlines()
    assert printed[-1] == "Report: runs/moire_at/seed0/report.html"
    for begin, count in (
        ("Moiré Attack 4/255", 1),
        ("training: moire_at ", 1),
        ("Epoch", 1 + 2 + 2),
    ):
        assert sum(line.startswith(begin) for line in printed) == count, begin
    once = "compiles its CPU kernels, once on this machine"  # this process, or another
    assert [line for line in err.splitlines() if once not in line] == []


def test_the_baseline_trains_as_long_as_the_run(whole):
    clean, base, m = (
        read_metrics(whole[0] / f"runs/{recipe}/seed0")
        for recipe in ("clean", "baseline", "moire_at")
    )
    shared_keys = {"recipe", "seed", "data", "model", "train", "environment"}
    assert set(m["start"]) == shared_keys
    assert set(m["baseline"]) == shared_keys | {"clean_accuracy", "reattack"}
    for ours, theirs in ((m["start"], clean), (m["baseline"], base)):
        assert {key: ours[key] for key in shared_keys} == {key: theirs[key] for key in shared_keys}
    start = clean["train"]["seconds"]
    assert clean["train"]["total_seconds"] == start
    for side, epochs in ((clean, (1, 1)), (base, (2, 3)), (m, (2, 3))):
        cost = side["train"]
        assert (cost["epochs"], cost["total_epochs"]) == epochs
        assert side is clean or cost["total_seconds"] == pytest.approx(cost["seconds"] + start)
    assert (clean["start"], clean["baseline"], base["baseline"]) == (None, None, None)
    assert base["start"] == m["start"] and base["gain"] == {}
    assert base["train"]["init"] == "clean" and clean["train"]["init"] == "random"


@pytest.mark.usefixtures("nothing_trained")
def test_a_plain_run_is_attacked_once_it_is_asked_for(copied):
    folder = copied / "baseline/seed0"
    before, beside = read_metrics(folder), read_metrics(copied / "moire_at/seed0")
    assert "reattack" not in before and set(before["time"]) == {"train"}
    assert "trust" in beside
    found = fit.fit(configured("recipe=baseline", *TINY, f"runs={copied}"))
    assert found["trust"] and found["time"]["checks"] > 0 and found["time"]["re-attack"] > 0
    assert (folder / "report.html").is_file()
    kept = read_metrics(folder)
    for name in ("train", "start", "config", "environment"):
        assert found[name] == kept[name] == before[name]
    assert kept["trust"] == found["trust"] and kept["reattack"] == found["reattack"]
    assert kept["reattack"] == beside["baseline"]["reattack"], "the other run's records are read"


@pytest.mark.usefixtures("nothing_trained")
def test_a_finished_run_is_attacked_in_another_way_and_not_trained_again(copied, monkeypatch):
    folder = copied / "moire_at/seed0"
    weights, before = (folder / "best.ckpt").read_bytes(), read_metrics(folder)
    given = configured("recipe=moire_at", *TINY, *BRIEF, f"runs={copied}")
    assert Run(given).stage() == "trained"
    monkeypatch.setattr(machine, "command", lambda: "this command")
    found = fit.fit(given)
    assert (folder / "best.ckpt").read_bytes() == weights
    assert [p.name for p in folder.parent.iterdir() if p.name[0] != "."] == ["seed0"]
    assert found["reattack"][0]["n"] == found["config"]["reattack"]["n"] == 4
    assert found["command"] == "this command" and found["train"] == before["train"]
    assert Run(given).stage() == "finished" and read_metrics(folder) == found
    assert trained.read(folder).cfg.reattack.n == 4
    start = start_of(Run(given))
    assert start.stage() == "trained", "it was never attacked"
    (start.folder / "best.ckpt").unlink()
    assert start.stage() == "begun"


def test_a_re_attack_takes_what_the_run_has_computed(copied):
    before = {path: path.read_bytes() for path in copied.glob("*/seed0/records/*.jsonl")}
    assert len(before) == 2
    again = attack_in(copied, "screen_photo-*")
    assert {path: path.read_bytes() for path in before} == before
    m = read_metrics(copied / "moire_at/seed0")
    for name in ("reattack", "gain", "correct", "trust"):
        assert again[name] == m[name]
    assert again["baseline"]["reattack"] == m["baseline"]["reattack"]
    given = ["scene=paper_code", "reattack.n=3", "reattack.eps=[0.02]"]
    other = attack_in(copied, "paper_code-n3-steps2-*", *given)
    assert other["scene_name"] == "paper_code" and other["baseline"]["recipe"] == "baseline"
    assert other["reattack"][0]["n"] == other["baseline"]["reattack"][0]["n"] == 3


def attack_in(runs, name, *given):
    """Attack the copied run by the command: the metrics beside the report of that name."""
    done = inside("reattack.py", "run=runs/moire_at/seed0", *given, cwd=runs.parent)
    assert done.returncode == 0, done.stderr
    (report,) = runs.glob(f"moire_at/seed0/reattack/{name}/ladder/report.html")
    return read_metrics(report.parent)


def test_the_gain_is_over_the_baseline_not_the_start():
    right, wrong = {"clean": "1" * 8}, {"clean": "0" * 8}
    cfg = configured("recipe=moire_at", *TINY)
    start = replace(run_metrics(cfg, None, None), correct=wrong)
    alone = replace(run_metrics(cfg, None, start.plain()), correct=right)
    for baseline, gain in ((wrong, 1.0), (right, 0.0)):
        ladder = {"clean_accuracy": 0.0, "reattack": [], "correct": baseline}
        m = with_baseline(alone, start.plain(), ladder).to_dict()
        assert m["gain"] == {"clean": gain}
    assert alone.to_dict()["gain"] == {}


def test_plain_runs_are_reused_only_where_their_settings_fit(whole, capsys):
    runs = whole[0] / "runs"
    cfg = configured("recipe=moire_aug", *TINY, f"runs={runs}", "reattack.n=6")
    folders = [runs / f"{recipe}/seed0" for recipe in ("clean", "baseline")]
    before = [(folder / "best.ckpt").stat().st_mtime_ns for folder in folders]
    start, baseline = phases.plain_runs(Run(cfg), load(cfg.data))
    assert (start.recipe, baseline.recipe) == ("clean", "baseline")
    assert [(folder / "best.ckpt").stat().st_mtime_ns for folder in folders] == before
    said = capsys.readouterr().out
    assert f"The start is reused from {folders[0]}" in said
    assert f"The baseline is reused from {folders[1]}" in said
    other = Run(configured("recipe=moire_aug", *TINY, "data.train=80", f"runs={runs}"))
    assert start_of(other).stage() == baseline_of(other).stage() == "other"


def test_plain_runs_are_reused_in_any_scene(copied, capsys):
    """They never look at one; their metrics then are of the scene that they are compared in."""
    for _ in range(2):
        cfg = configured("recipe=moire_aug", *TINY, f"runs={copied}", "scene=phone_at_laptop")
        plain = phases.plain_runs(Run(cfg), load(cfg.data))
        assert capsys.readouterr().out.count("is reused from") == 2
        for metrics in plain:
            written = read_metrics(copied / metrics.recipe / "seed0")
            assert metrics.to_dict() == written and metrics.scene_name == "phone_at_laptop"
    run = trained.read(copied / "moire_at/seed0")
    assert trained.read_baseline_of(run).cfg.recipe == "baseline"
    assert Run(replace(run.cfg, scene="phone_at_laptop")).training_fingerprint != (
        Run(run.cfg).training_fingerprint
    )


def test_a_baseline_that_was_attacked_keeps_its_results_in_another_scene(copied):
    folder = copied / "baseline/seed0"
    metrics = RunMetrics.read(folder)
    replace(metrics, reattack=[], correct={}, clean_accuracy=0.5).write(folder)
    (folder / "report.html").write_text("of its own attack")
    files = [folder / name for name in ("metrics.json", "config.yaml", "report.html")]
    before = [path.read_bytes() for path in files]
    cfg = configured("recipe=moire_aug", *TINY, f"runs={copied}", "scene=phone_at_laptop")
    _, baseline = phases.plain_runs(Run(cfg), load(cfg.data))
    assert baseline.plain() == metrics.plain()
    assert [path.read_bytes() for path in files] == before


def test_a_baseline_of_other_settings_is_not_attacked(copied, capsys):
    run = trained.read(copied / "moire_at/seed0")
    assert trained.read_baseline_of(run).cfg.recipe == "baseline"
    path = copied / "baseline/seed0/config.yaml"
    path.write_text(path.read_text().replace("epochs: 2", "epochs: 3"))
    assert trained.read_baseline_of(run) is None
    assert "no baseline is attacked beside this run" in capsys.readouterr().out


def test_an_interrupted_start_is_resumed_before_its_recipe(tmp_path, monkeypatch, capsys):
    given = ["recipe=moire_aug", *TINY, "train.epochs=1", f"runs={tmp_path}", "resume=true"]
    cfg = configured(*given)
    train(start_of(Run(cfg)).config)
    seen, train_run = [], phases.train_run

    def train_plain_runs(run, splits, start):
        seen.append(run.config.recipe)
        return train_run(run, splits, start) if run.config.recipe != "moire_aug" else 1 / 0

    monkeypatch.setattr(phases, "train_run", train_plain_runs)
    with pytest.raises(ZeroDivisionError):
        fit.fit(cfg)
    assert "Training is complete: the weights are read from" in capsys.readouterr().out
    assert seen == ["clean", "baseline", "moire_aug"]


def test_a_damaged_checkpoint_gets_a_sentence(copied):
    best = copied / "moire_at/seed0/best.ckpt"
    for content in (best.read_bytes()[:5000] + b"\x00" * 64, b"\x00" * 64, None):
        best.unlink()
        if content:
            best.write_bytes(content)
        with pytest.raises(ValueError, match=r"is not a run's folder|could not be read"):
            trained.read(best.parent)
