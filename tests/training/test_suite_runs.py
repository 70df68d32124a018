"""Suites through the real command: killed, shared by processes, with networks of the user's own,
and given what they cannot use."""

import json
import os
import shutil
import signal
import time
import warnings
from types import SimpleNamespace

import pytest
import torch

from moireaug.defenses import demoire
from tests.training.forked import Command
from tests.training.tiny_suites import TINY, cells, folder_of, records_of, suite
from training.attack import suites
from training.attack.suites import networks_of
from training.config.command_line import check_keys
from training.config.schema import Reattack, ReattackConfig
from training.data.eval_batches import EvalBatches
from training.data.splits import Splits

pytestmark = pytest.mark.usefixtures("as_the_command_is")

TWO = ("trainer.devices=2", "trainer.strategy=ddp")


@pytest.fixture(scope="module")
def straight(weights, tmp_path_factory):
    """One suite by one process, never stopped."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return suite("noise_position", weights, tmp_path_factory.mktemp("straight"))


def run(cwd, weights, *more, ranks="spawn"):
    given = ["model=small_resnet", f"weights={weights}", *TINY, *more]
    return Command("reattack.py", *given, cwd=cwd, ranks=ranks)


def metrics_of(cwd, name):
    return json.loads((folder_of(cwd / "runs", name) / "metrics.json").read_text())


def test_a_killed_evaluation_goes_on_where_it_was(weights, straight, tmp_path):
    """And gives the figures of one that was never stopped."""
    process = run(tmp_path, weights, "suite=noise_position")
    until, kept = time.time() + 240, 0
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
    process = run(tmp_path, weights, "suite=noise_position", *TWO, ranks="fork")
    out, err = process.communicate()
    assert process.returncode == 0, err
    assert out.count("Report: ") == 1
    folder = tmp_path / "runs/reattack/small_resnet/records"
    batches = []
    for path in sorted(folder.glob("*.jsonl")):
        batches.append({json.loads(line)["batch"] for line in path.read_text().splitlines()})
    assert sorted(batches, key=min) == [{0}, {1}]
    assert cells(metrics_of(tmp_path, "noise_position")) == cells(straight)


def test_a_suite_ends_where_one_of_its_processes_is_lost(weights, tmp_path):
    more = ("suite=noise_position", "reattack.steps=2000")
    process = run(tmp_path, weights, *more, *TWO, ranks="fork")
    until, kept = time.time() + 240, 0
    while time.time() < until and not kept and process.poll() is None:
        kept = len(list(tmp_path.glob("runs/reattack/small_resnet/records/*.jsonl")))
        time.sleep(0.01)
    os.kill(process.ranks()[1], signal.SIGKILL)
    _, err = process.communicate()
    assert process.returncode == 1 and err.count("another process of this run was lost") == 1
    assert "What is complete is kept" in err and not list(tmp_path.rglob("metrics.json"))


def test_the_first_process_to_finish_waits_for_the_last(monkeypatch):
    """Longer than the half hour that torch allows."""
    done = []
    attack = SimpleNamespace(run=lambda *share: done.append(share))
    fabric = SimpleNamespace(world_size=2, global_rank=1)
    subject = SimpleNamespace(model=None, protocol=None, records=None)
    for name, function in {
        "fabric_of": lambda settings: fabric,
        "suite_config": lambda *given: None,
        "SuiteAttack": lambda *given: attack,
        "new_group": lambda backend, timeout: (backend, timeout.days),
        "barrier": done.append,
    }.items():
        monkeypatch.setattr(suites, name, function)
    assert suites.attack_by_suite(ReattackConfig(suite="paper"), subject) is None
    assert done == [("paper", 1, 2), ("gloo", 30)]


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
        (["suite=transfer", "targets={nobody: FILE}"], "targets.nobody='FILE' is neither a run's"),
        (["suite=transfer", "targets={resnet18: FILE}"], "no weights file 'FILE'"),
        (["suite=defences", "demoire=nothing:there"], "='nothing:there' could not be imported"),
        (["suite=defences", "demoire=math:pi"], "is a float, not a callable"),
        (["suite=demoireing"], "suite=demoireing needs demoiréing networks: pass networks=DIR"),
        (["suite=demoireing", "networks=nowhere"], "networks='nowhere' has no weights"),
        (["suite=demoireing", "networks={amnet: none.pt}"], "no weights file 'none.pt'"),
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
    with pytest.raises(SystemExit, match=r"pass targets whole, as in targets='{resnet18: FILE, "):
        check_keys(["targets.resnet18=FILE"], ReattackConfig)
    with pytest.raises(SystemExit, match=r"pass networks whole, as in networks='{mopnet: FILE, "):
        check_keys(["networks.mopnet=FILE"], ReattackConfig)


@pytest.mark.parametrize(("size", "batch"), [(24, 96), (224, 25), (299, 14), (4000, 1)])
def test_batches_fit_the_memory_unless_given(size, batch):
    data = torch.utils.data.TensorDataset(torch.zeros(300, 1), torch.zeros(300))
    splits = Splits(data, data, data, {}, 1)
    batches = EvalBatches(splits, Reattack(n=200), size, torch.device("cpu"))
    assert batches.size == batch and len(batches.unattacked_images(splits)) == 100
