"""Suites through the real command: every table, nothing computed twice, the same figures from
several processes."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import pytest
import torch
from hydra import compose, initialize
from hydra.core.global_hydra import GlobalHydra

from moireaug import Scene
from moireaug.defenses import demoire
from moireaug.evaluation import GROUPS
from moireaug.evaluation.frame import read_published
from moireaug.evaluation.report.suite_view import CONTROLS
from moireaug.evaluation.suites.scenes import other_scenes
from training import attacking, models, reattack
from training.attacking import Plan, protocol_of
from training.data import Splits, load
from training.eval_batches import EvalBatches
from training.schema import Reattack, as_config, check_keys
from training.suites import networks_of

pytestmark = pytest.mark.usefixtures("as_the_command_is")

ROOT = Path(__file__).resolve().parents[2]
TINY = [
    "data.train=60",
    "data.val=16",
    "data.test=24",
    "data.size=24",
    "reattack.n=6",
    "reattack.batch_size=3",
    "reattack.steps=1",
    "trainer.accelerator=cpu",
]


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """Of a small network that was never trained, but has the first image of the test right, so that
    one counts."""
    torch.manual_seed(0)
    path, model = (
        tmp_path_factory.mktemp("weights") / "small.pt",
        models.build("small_resnet", 16).eval(),
    )
    cfg = configured()
    images, labels = protocol_of(as_config(cfg), load(cfg.data)).batches[0]
    with torch.no_grad():
        logits, label = model(images)[0], labels[0]
        model.head.bias[label] += logits.max() - logits[label] + 1e-3
    torch.save(model.state_dict(), path)
    return path


def configured(*overrides):
    GlobalHydra.instance().clear()
    with initialize(version_base="1.3", config_path=None):
        return compose("reattack", [*TINY, *overrides])


def suite(name, weights, runs, *more):
    cfg = configured(
        "model=small_resnet", f"weights={weights}", f"suite={name}", f"runs={runs}", *more
    )
    return reattack.reattack(cfg, [])


def folder_of(runs, name, n=6):
    """Where a suite of n images wrote its report."""
    (found,) = (runs / "reattack/small_resnet").glob(f"signs-*-n{n}-steps1-*/{name}")
    return found


def records_of(runs):
    """The one file of records."""
    (found,) = (runs / "reattack/small_resnet/records").glob("records-*.jsonl")
    return found


@pytest.fixture(scope="module")
def whole(weights, tmp_path_factory):
    """The suite of all, with a target that is at hand and one that is not."""
    runs = tmp_path_factory.mktemp("runs")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = suite(
            "paper",
            weights,
            runs,
            f"targets={{small_resnet: {weights}, resnet34: null}}",
            "reattack.n=3",
        )
    return found, folder_of(runs, "paper", 3).parent


@pytest.fixture(scope="module")
def straight(weights, tmp_path_factory):
    """One suite by one process, never stopped."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return suite("noise_position", weights, tmp_path_factory.mktemp("straight"))


def cells(metrics):
    """Every figure but the times."""
    return {
        (name, r["row"], r["column"]): {k: v for k, v in r.items() if k != "seconds"}
        for name, rows in metrics["tables"].items()
        for r in rows
    }


def test_the_paper_suite_has_every_table(whole):
    metrics, _ = whole
    assert list(metrics["tables"]) == list(GROUPS["paper"])
    found = cells(metrics)
    for name, row, column in found:
        cell = found[name, row, column]
        pooled = 8 if column.startswith("all") else 1
        assert cell["n"] == 3 * pooled and cell["counted"] <= cell["n"], (name, row, column)
        assert 0 <= cell["low"] <= (cell["success"] or 0) <= cell["high"] <= 1
        assert len(cell["outcomes"]) == cell["n"]
    for name in GROUPS["paper"]:
        columns = {c for n, _, c in found if n == name}
        assert columns & set(CONTROLS) or (name == "threat" and "all_no_moire" in columns), name
    known = {tuple(line[:3]): line[3] for line in read_published().itertuples(index=False)}
    # of models and networks whose weights were not given
    lacking = {key for key in known if key[0] == "transfer"}
    lacking |= {key for key in known if key[0] == "demoireing" and key[1] != "undefended"}
    absent = known.keys() - found.keys() - lacking
    assert not absent, "the paper's figures must stand beside cells that exist"
    for key in known.keys() & found.keys():
        assert found[key]["paper"] == known[key]
    assert ("transfer", "small_resnet", "ma") in found and (
        "transfer",
        "resnet34",
        "ma",
    ) not in found


def test_a_group_is_one_report(weights, tmp_path):
    found = suite("recipes", weights, tmp_path, "reattack.n=3")
    assert list(found["tables"]) == list(GROUPS["recipes"])
    folder = folder_of(tmp_path, "recipes", 3)
    page, text = (folder / "report.html").read_text(), (folder / "tables.md").read_text()
    for title in (
        "The worst of the attackers",
        "Natural moiré in other scenes",
        "Verdict: how much is the moiré",
    ):
        assert title in page
    assert (
        "| own scene |" in text
        and "Without any attacker the moiré adds most for" in text
        and "nan" not in text
    )
    # the attackers and controls of one bound, and the scenes
    scenes = 1 + len(other_scenes(Scene.preset("screen_photo")))
    assert page.count('<div class="cell"') == 6 + scenes


def test_the_worst_case_is_no_better_than_any_of_its_row(whole):
    rows = whole[0]["tables"]["adaptive"]
    for name in {r["row"] for r in rows}:
        rates = {
            r["column"]: r["success"] for r in rows if r["row"] == name and r["column"] != "clean"
        }
        assert rates.pop("worst") >= max(rates.values())


def test_every_form_of_the_tables_is_written(whole):
    metrics, out = whole
    folder = out / "paper"
    assert {p.name for p in folder.iterdir()} == {
        "report.html",
        "metrics.json",
        "tables.md",
        "results.csv",
    }
    page = (folder / "report.html").read_text()
    for text in (
        "Verdict: how much is the moiré, how much the noise",
        "Can it be trusted?",
        "Resnet34: weights not at hand",
    ):
        assert text in page
    assert page.index("Verdict") < page.index("Success of the Moiré Attack (paper, table 1)</h2>")
    with (folder / "results.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    wanted = {
        "table",
        "row",
        "column",
        "condition",
        "eps",
        "steps",
        "success",
        "low",
        "high",
        "accuracy",
        "paper",
        "psnr",
    }
    assert wanted <= lines[0].keys() and len(lines) == len(cells(metrics))
    assert {line["table"] for line in lines} == set(GROUPS["paper"])
    words = (folder / "tables.md").read_text()
    assert (
        words.count("\n## ") == len(GROUPS["paper"]) + 1
        and "| resnet34 | – |" in words
        and "nan" not in words
    )
    assert json.loads((folder / "metrics.json").read_text())["trust"] == metrics["trust"]
    assert len(metrics["trust"]) == 10 and metrics["trust_n"] == 3


def test_another_suite_takes_what_is_there(whole, weights):
    runs = whole[1].parents[2]
    records = records_of(runs)
    before = records.read_bytes()
    again = suite("jpeg", weights, runs, "reattack.n=3")
    assert cells(again) == {key: cell for key, cell in cells(whole[0]).items() if key[0] == "jpeg"}
    assert records.read_bytes() == before


def test_a_smoke_test_leaves_a_long_evaluation_alone(whole, weights):
    runs = whole[1].parents[2]
    suite("jpeg", weights, runs, "reattack.n=3")
    folder = folder_of(runs, "jpeg", 3)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    for other in ("reattack.n=2", "reattack.steps=2", "reattack.seed=5", "reattack.eps=[0.01]"):
        suite("noise_position", weights, runs, *dict.fromkeys(["reattack.n=3", other]))
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert len(list(folder.parents[1].glob("*/noise_position"))) == 4


def test_the_checks_look_at_as_many_images_as_are_asked_for(weights, tmp_path, monkeypatch):
    """With another suite they take no more than they need."""
    monkeypatch.setattr(attacking, "TRUST_N", 2)
    given = ("reattack.n=4", "reattack.batch_size=2")
    found = suite("trust", weights, tmp_path, *given)
    assert found["n"] == found["trust_n"] == 4 and len(found["trust"]) == 10
    beside = suite("unseen", weights, tmp_path, *given)
    assert beside["n"] == 4 and beside["trust_n"] == 2 and len(beside["trust"]) == 10


def test_the_ladder_is_a_suite_like_any_other(weights, tmp_path):
    first = suite("ladder", weights, tmp_path)
    records = records_of(tmp_path)
    before = records.read_bytes()
    again = suite("ladder", weights, tmp_path)
    assert records.read_bytes() == before
    assert [r["accuracy"] for r in again["reattack"]] == [r["accuracy"] for r in first["reattack"]]
    assert (folder_of(tmp_path, "ladder") / "report.html").is_file()


def test_pictures_of_another_suite_are_shown_again(weights, tmp_path):
    suite("noise_position", weights, tmp_path, "reattack.n=3")
    suite("jpeg", weights, tmp_path, "reattack.n=3")
    later = (folder_of(tmp_path, "jpeg", 3) / "report.html").read_text()
    suite("jpeg", weights, tmp_path / "first", "reattack.n=3")
    first = (folder_of(tmp_path / "first", "jpeg", 3) / "report.html").read_text()
    assert later.count('<div class="cell"') == first.count('<div class="cell"') == 8


def test_a_scene_without_a_choice_of_pose_says_so(weights, tmp_path):
    still = suite("adaptive", weights, tmp_path, "scene=paper_code", "reattack.n=3")
    assert "turning" not in {r["column"] for r in still["tables"]["adaptive"]}
    page = (folder_of(tmp_path, "adaptive", 3) / "report.html").read_text()
    assert "No attacker turns the camera: optimise" in page


def test_records_that_are_missing_are_not_passed_over(weights, tmp_path):
    """Of two processes one alone has run."""
    cfg = as_config(configured("model=small_resnet", f"weights={weights}"))
    model = models.as_model(cfg.model, 16, cfg.weights, whole=True)
    plan = Plan(model, "unseen", protocol_of(cfg, load(cfg.data)), tmp_path)
    plan.run("one of two", rank=0, world=2)
    with pytest.raises(
        ValueError, match=r"\d+ of \d+ records are missing: other processes did not finish"
    ):
        plan.results()


def run(cwd, weights, *more, **options):
    names = ["model=small_resnet", f"weights={weights}", *TINY, *more]
    env = os.environ | {
        "OMP_NUM_THREADS": "1",
        "OMP_WAIT_POLICY": "passive",
        "PYTHONPATH": str(ROOT),
    }
    process = subprocess.Popen(
        [sys.executable, str(ROOT / "training/reattack.py"), *names],
        cwd=cwd,
        env=env,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )
    return process


def metrics_of(cwd, name):
    return json.loads((folder_of(cwd / "runs", name) / "metrics.json").read_text())


def test_a_killed_evaluation_goes_on_where_it_was(weights, straight, tmp_path):
    """And gives the figures of one that was never stopped."""
    process = run(tmp_path, weights, "suite=noise_position")
    until, kept = time.time() + 120, 0
    while time.time() < until and kept < 4 and process.poll() is None:
        found = list(tmp_path.glob("runs/reattack/small_resnet/records/records-0.jsonl"))
        kept = len(found[0].read_text().splitlines()) if found else 0
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert kept >= 4 and not list(tmp_path.rglob("metrics.json"))
    records = records_of(tmp_path / "runs")
    text = records.read_text()
    before = text[: text.rfind("\n") + 1]
    records.write_text(text + '{"key": "0a", "mo')  # what a kill in the middle of a write leaves
    stopped = suite("noise_position", weights, tmp_path / "runs")
    assert records.read_text().startswith(before)
    lines = [json.loads(line) for line in records.read_text().splitlines()]
    assert len({r["key"] for r in lines}) == len(lines)  # nothing was done twice
    assert cells(stopped) == cells(straight)


def test_processes_share_the_work(weights, straight, tmp_path):
    """Two of Lightning's processes: each its own batches, one report, the figures of one
    process."""
    process = run(
        tmp_path, weights, "suite=noise_position", "trainer.devices=2", "trainer.strategy=ddp"
    )
    out, err = process.communicate(timeout=240)
    assert process.returncode == 0, err
    assert out.count("Report: ") == 1
    folder = tmp_path / "runs/reattack/small_resnet/records"
    batches = []
    for path in sorted(folder.glob("*.jsonl")):
        batches.append({json.loads(line)["batch"] for line in path.read_text().splitlines()})
    assert sorted(batches, key=min) == [{0}, {1}]
    assert cells(metrics_of(tmp_path, "noise_position")) == cells(straight)


def test_a_network_against_moire_is_a_defence(weights, tmp_path):
    found = suite("defences", weights, tmp_path, "demoire=torch.nn.functional:relu", "reattack.n=3")
    rows = {r["row"] for r in found["tables"]["defences"]}
    relu = "torch.nn.functional:relu"
    assert {relu, "quilting", "tvm"} <= rows
    same = []
    for row in (relu, "undefended"):
        same.append(
            {r["column"]: r["success"] for r in found["tables"]["defences"] if r["row"] == row}
        )
    assert same[0] == same[1]  # relu changes nothing in [0, 1]


@pytest.fixture(scope="module")
def networks(tmp_path_factory):
    """A folder of two small demoiréing networks that were never trained."""
    folder = tmp_path_factory.mktemp("networks")
    for name in ("amnet", "esdnet"):
        torch.manual_seed(0)
        demoire.save(demoire.build(name, width=0.05), folder / f"{name}.pt")
    return folder


def test_demoireing_networks_are_rows(weights, networks, tmp_path):
    run = tmp_path / "run"
    run.mkdir()
    shutil.copy(networks / "amnet.pt", run / "weights.pt")
    rows = []
    for given in (networks, f"{{mine: {networks / 'esdnet.pt'}, amnet: {run}}}"):
        more = ["reattack.n=1", f"networks={given}"]
        found = suite("demoireing", weights, tmp_path / "runs", *more)
        rows.append({r["row"] for r in found["tables"]["demoireing"]})
    assert rows == [{"undefended", "amnet", "esdnet"}, {"undefended", "amnet", "mine"}]
    assert list(networks_of(str(run), torch.device("cpu"))) == ["amnet"]
    for page in tmp_path.rglob("tables.md"):
        text = page.read_text("utf-8")
        assert "| AMNet |" in text and "| MopNet | – |" in text
        assert "MopNet: no weights were given" in text


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["suite=defenses"], "suite must be one of .* got 'defenses'. Did you mean 'defences'"),
        (
            ["suite=transfer", "targets={nobody: FILE}"],
            "targets.nobody='FILE' is neither a run's folder",
        ),
        (["suite=transfer", "targets={resnet18: FILE}"], "no weights file 'FILE'"),
        (
            ["suite=defences", "demoire=nothing:there"],
            "demoire='nothing:there' could not be imported",
        ),
        (["suite=defences", "demoire=math:pi"], "is a float, not a callable"),
        (["suite=demoireing"], "suite=demoireing needs demoiréing networks: pass networks=DIR"),
        (["suite=demoireing", "networks=nowhere"], "networks='nowhere' has no weights"),
        (["suite=demoireing", "networks={amnet: none.pt}"], "no weights file 'none.pt'"),
        (
            ["suite=success", "reattack.batch_size=0"],
            "reattack.batch_size must be at least 1; got 0",
        ),
    ],
)
def test_mistakes_get_a_sentence(more, message, weights, tmp_path):
    with pytest.raises(ValueError, match=message):
        suite("success", weights, tmp_path, *more)
    assert not list(tmp_path.rglob("report.html"))


def test_a_network_is_not_shown_as_another(weights, networks, tmp_path):
    given = f"networks={{mopnet: {networks / 'amnet.pt'}}}"
    with pytest.raises(ValueError, match=r"'mopnet' names another network than .*, amnet"):
        suite("demoireing", weights, tmp_path, given)


def test_a_target_on_its_own_says_how_to_pass_it():
    from training.schema import ReattackConfig

    with pytest.raises(
        SystemExit, match=r"pass targets whole, as in targets='\{resnet18: FILE, ...\}'"
    ):
        check_keys(["targets.resnet18=FILE"], ReattackConfig)


@pytest.mark.parametrize(("size", "batch"), [(24, 96), (224, 25), (299, 14), (4000, 1)])
def test_batches_fit_the_memory_unless_given(size, batch):
    data = torch.utils.data.TensorDataset(torch.zeros(300, 1), torch.zeros(300))
    splits = Splits(data, data, data, {}, 1)
    batches = EvalBatches(splits, Reattack(n=200), size, torch.device("cpu"))
    assert batches.size == batch and len(batches.others(splits)) == 100
