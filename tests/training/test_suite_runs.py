"""Suites through the real command: killed, shared by processes, with networks of the user's own,
and given what they cannot use."""

import json
import shutil
import warnings
from types import SimpleNamespace

import pytest
import torch
from hydra.errors import HydraException

from moireaug.defenses import demoire
from tests.training.forked import Command
from tests.training.small import wait
from tests.training.tiny_suites import TINY, cells, configured, folder_of, record_files, suite
from training import reattack
from training.attack.subject import subject_of_weights
from training.attack.suite_config import networks_of, suite_config
from training.config.command_line import why_refused
from training.config.schema import Reattack, ReattackConfig
from training.data.splits import EvalBatches, Splits
from training.trainer.ranks import fabric_of

pytestmark = pytest.mark.usefixtures("as_the_command_is")

TWO = ("trainer.devices=2", "trainer.strategy=ddp")
RELU = "torch.nn.functional:relu"


@pytest.fixture(scope="module")
def straight(weights, tmp_path_factory):
    """One suite by one process, never stopped."""
    with warnings.catch_warnings(action="ignore"):
        return suite("noise_position", weights, tmp_path_factory.mktemp("straight"))


def run(cwd, weights, *more, ranks="spawn"):
    given = ["model=small_resnet", f"weights={weights}", "suite=noise_position", *TINY, *more]
    return Command("reattack.py", *given, cwd=cwd, ranks=ranks)


def records_in(cwd):
    """The complete records of a running command."""
    found = []
    for path in sorted(cwd.glob("runs/reattack/small_resnet/records/*.jsonl")):
        found += [line for line in path.read_text().splitlines(True) if line.endswith("\n")]
    return [json.loads(line) for line in found]


def test_a_killed_evaluation_goes_on_where_it_was(weights, straight, tmp_path):
    """And gives the figures of one that was never stopped."""
    process = run(tmp_path, weights)
    wait(process, lambda: len(records_in(tmp_path)) >= 4)
    process.kill()
    process.communicate()
    assert not list(tmp_path.rglob("metrics.json"))
    (records,) = record_files(tmp_path / "runs")
    text = records.read_text()
    before = text[: text.rfind("\n") + 1]
    records.write_text(text + '{"key": "0a", "mo')  # what a kill in the middle of a write leaves
    stopped = suite("noise_position", weights, tmp_path / "runs")
    assert records.read_text().startswith(before)
    lines = records_in(tmp_path)
    assert len({r["key"] for r in lines}) == len(lines)  # nothing was done twice
    assert cells(stopped) == cells(straight)


def test_processes_share_the_work(weights, straight, tmp_path):
    """Two of Lightning's processes: each its own batches, one report, the figures of one
    process."""
    process = run(tmp_path, weights, *TWO, ranks="fork")
    out, err = process.communicate()
    assert process.returncode == 0, err
    assert out.count("Report: ") == 1
    shares = {}
    for path in tmp_path.glob("runs/reattack/small_resnet/records/*.jsonl"):
        lines = path.read_text().splitlines()
        shares[path.name] = {json.loads(line)["batch"] for line in lines}
    assert sorted(shares.values(), key=min) == [{0}, {1}]
    metrics = folder_of(tmp_path / "runs", "noise_position") / "metrics.json"
    assert cells(json.loads(metrics.read_text())) == cells(straight)


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
        monkeypatch.setattr(reattack, name, function)
    assert reattack.attack_by_suite(ReattackConfig(suite="paper"), subject) is None
    assert done == [("paper", 1, 2), ("gloo", 30)]


def test_a_network_against_moire_is_a_defence(weights, tmp_path):
    given = ["model=small_resnet", f"weights={weights}", "suite=defences", f"demoire={RELU}"]
    cfg = configured(*given, f"runs={tmp_path}")
    config = suite_config(cfg, subject_of_weights(cfg), fabric_of(cfg.trainer))
    assert config.defences.keys() >= {RELU, "quilting"} and not config.networks


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
    for given, names in ((str(run), ["amnet"]), (str(networks), ["amnet", "esdnet"])):
        assert list(networks_of(given, torch.device("cpu"))) == names
    given = f"networks={{mine: {networks / 'esdnet.pt'}, amnet: {run}}}"
    found = suite("demoireing", weights, tmp_path, given, f"demoire={RELU}", "reattack.n=1")
    rows = {}
    for cell in found["tables"]["demoireing"]:
        rows.setdefault(cell["row"], {})[cell["column"]] = cell["success"]
    assert rows.keys() == {"undefended", "amnet", "mine", RELU}
    shared = rows[RELU].keys() & rows["undefended"].keys()
    assert "ma" in shared  # ReLU changes nothing in [0, 1]
    assert all(rows[RELU][column] == rows["undefended"][column] for column in shared)
    text = (folder_of(tmp_path, "demoireing", 1) / "tables.md").read_text("utf-8")
    assert "| AMNet |" in text and "| MopNet | – |" in text
    assert "MopNet: no weights were given" in text


MISTAKES = [
    (["suite=defenses"], "suite must be one of .* got 'defenses'. Did you mean 'defences'"),
    (["suite=transfer", "targets={nobody: FILE}"], "targets.nobody='FILE' is neither a run's"),
    (["suite=transfer", "targets={resnet18: FILE}"], "no weights file 'FILE'"),
    (["suite=defences", "demoire=nothing:there"], "='nothing:there' could not be imported"),
    (["suite=defences", "demoire=math:pi"], "is a float, not a callable"),
    (["suite=defences", "demoire=os:getcwd"], "with the code: getcwd.identity = 'first'.$"),
    (["suite=demoireing"], "suite=demoireing needs demoiréing networks: pass networks=DIR"),
    (["suite=demoireing", "networks=nowhere"], "networks='nowhere' has no weights"),
    (["suite=demoireing", "networks={amnet: none.pt}"], "no weights file 'none.pt'"),
    (["suite=demoireing", "networks={mopnet: AMNET}"], "'mopnet' names another .*, amnet"),
]


@pytest.mark.parametrize(("more", "message"), MISTAKES)
def test_mistakes_get_a_sentence(more, message, weights, networks, tmp_path):
    more = [given.replace("AMNET", str(networks / "amnet.pt")) for given in more]
    with pytest.raises(ValueError, match=message):
        suite("success", weights, tmp_path, *more)
    assert not list(tmp_path.rglob("report.html"))


def test_a_target_on_its_own_says_how_to_pass_it():
    for key, example in (("targets", "resnet18"), ("networks", "mopnet")):
        with pytest.raises(HydraException) as error:
            configured(f"{key}.{example}=FILE")
        advice = f"Pass {key} whole, as in {key}='{{{example}: FILE, "
        assert advice in why_refused(error.value, ReattackConfig)


def test_batches_fit_the_memory_unless_given():
    data = torch.utils.data.TensorDataset(torch.zeros(300, 1), torch.zeros(300))
    splits = Splits(data, data, data, {}, 1)
    for side, size in ((24, 96), (224, 25), (299, 14), (4000, 1)):
        batches = EvalBatches(splits, Reattack(n=200), side, torch.device("cpu"))
        assert batches.size == size and len(batches.unattacked_images(splits)) == 100
