"""A run's folder from a stranger is data: nothing in it runs, and its text is not resolved."""

import json
import os
import sys

import pytest
import torch
import yaml

from tests.training import frontier_runs
from tests.training.forked import Command
from tests.training.small import TINY, configured
from tests.training.strangers import attack, put
from training.config import checks
from training.runs import trained
from training.runs.run import Run

pytestmark = pytest.mark.usefixtures("as_the_command_is")

MODULE = "import pathlib; pathlib.Path(__file__).with_name('it_ran').touch(); clean = abs"


def added(line):
    return lambda text: f"{text}{line}\n"


def replaced(before, after):
    return lambda text: text.replace(before, after)


HOSTILE = [
    (added("demoire: stranger:clean"), "Key 'demoire' not in 'Config'"),
    (added("targets: {other: /etc}"), "Key 'targets' not in 'Config'"),
    (added("_target_: os.system"), "Key '_target_' not in 'Config'"),
    (replaced("recipe: clean", "recipe: ${oc.env:SECRET}"), r"an interpolation \(\$\{\.\.\.\}\)"),
    (replaced("recipe: clean", 'recipe: "\\x24{oc.env:SECRET}"'), "an interpolation"),
    (replaced("scene: screen_photo", "scene: {${oc.env:SECRET}: 1}"), "could not be|an interp"),
    (replaced("scene: screen_photo", "scene: {a: &a [x, x], b: *a}"), "a YAML alias"),
    (replaced("clean", "!!python/object/apply:os.system [id]"), "could not be read as YAML"),
    (replaced("recipe: clean", "recipe: ../../elsewhere"), "recipe must be a name"),
    (replaced("recipe: clean", "recipe: .."), "recipe must be a name"),
    (replaced("recipe: clean", "recipe: ???"), "recipe is missing"),
    (replaced("model: attention_convnet", "model: os"), "model must be one of"),
    (replaced("scene: screen_photo", "scene: ../elsewhere"), "a preset must be one of"),
    (replaced("name: signs", "name: nothing"), "data.name must be one of"),
    (replaced("seed: 0", "seed: /etc"), "could not be converted to Integer"),
    (lambda text: "[" * 5_000, "could not be read as YAML"),
    (lambda text: "# " + "x" * 2_000_000, "far too long"),
    (lambda text: "- a", "holds no settings"),
    (lambda text: text[:100].replace("recipe: clean\n", ""), "is not a run's|could not be read"),
]


@pytest.mark.parametrize(("edit", "message"), HOSTILE)
def test_settings_that_are_more_than_data_are_refused(
    edit, message, tmp_path, monkeypatch, nothing_attacked
):
    monkeypatch.setenv("SECRET", "swordfish")
    folder = put(tmp_path, edit=edit)
    with pytest.raises(ValueError, match=message) as error:
        attack(folder)
    assert "swordfish" not in str(error.value) and "config.yaml" in str(error.value)
    assert not (folder / "reattack").exists()


def test_no_module_of_a_strangers_folder_runs(tmp_path):
    """Through the real command, started beside it."""
    folder = put(tmp_path / "runs", edit=added("suite: defences\ndemoire: stranger:clean"))
    for place in (tmp_path, folder):
        (place / "stranger.py").write_text(MODULE)
    process = Command("reattack.py", "run=runs/clean/seed0", "reattack.n=2", cwd=tmp_path)
    _, err = process.communicate()
    assert process.returncode == 1 and "error: " in err and "Traceback" not in err
    assert not list(tmp_path.rglob("it_ran"))


def test_options_that_act_come_from_the_command_line_alone(tmp_path):
    own = ["trainer.devices=64", "trainer.strategy=ddp", "data.download=true", "data.workers=9"]
    folder = put(tmp_path, *own)
    given = [f"run={folder}", "suite=defences", "demoire=torch:relu", "reattack.n=3"]
    assert trained.read(folder).cfg.data.download is False
    cfg = checks.merge_run_settings(
        trained.read(folder).cfg, configured(*given, name="reattack"), given
    )
    assert (cfg.demoire, cfg.suite, cfg.targets) == ("torch:relu", "defences", None)
    assert (cfg.trainer.devices, cfg.trainer.strategy) == (1, "auto")
    assert (cfg.data.download, cfg.data.workers, cfg.reattack.n) == (False, 0, 3)
    assert cfg.data.size == 24 and cfg.reattack.batch_size == 4, "these are the run's own"


class Bomb:
    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


NO_WEIGHTS = ([1], {"state_dict": {}, "epoch": 0}, {"state_dict": {"head.weight": 3}, "epoch": 0})


@pytest.mark.parametrize("where", ["run", "target"])
def test_a_checkpoint_is_tensors_alone(where, tmp_path):
    run, target = put(tmp_path), put(tmp_path, "seed=1")
    bad = run if where == "run" else target
    given = [] if where == "run" else [f"targets={{other: {bad}}}", "suite=transfer"]
    for content in (Bomb(tmp_path / "burst"), *NO_WEIGHTS):
        torch.save(content, bad / "best.ckpt")
        with pytest.raises(ValueError, match=r"best.ckpt (could not|holds no classifier)"):
            attack(run, *given)
    assert not (tmp_path / "burst").exists()


def test_no_baseline_is_attacked_whose_checkpoint_is_not_tensors(tmp_path, capsys):
    run, bad = put(tmp_path, "recipe=moire_aug"), put(tmp_path, "recipe=baseline")
    (bad / "metrics.json").write_text("{}")
    for content in (Bomb(tmp_path / "burst"), *NO_WEIGHTS):
        torch.save(content, bad / "best.ckpt")
        assert trained.read_baseline_of(trained.read(run)) is None
        said = capsys.readouterr().out
        assert "no baseline is attacked beside this run" in said
        assert "Recipe baseline with the run's other settings and resume=false" in said
    assert not (tmp_path / "burst").exists()


def test_metrics_of_a_stranger_are_numbers_or_nothing(tmp_path):
    folder = frontier_runs.put(tmp_path, "clean", 0, attacked=False)
    metrics = frontier_runs.metrics_in(folder)
    metrics["train"]["history"] = [{"epoch": 0, "loss": float("nan")}]
    frontier_runs.write(folder, metrics)
    assert trained.read_training_cost(folder).seconds == 10.0
    odd = ({"history": "<b>"}, {"seconds": "<b>"}, {"history": [{"loss": "x"}]}, {"init": "<b>"})
    odd += ({"seconds": 10**400}, {"history": [{"loss": 10**400}]})
    for train in (*(metrics["train"] | one for one in odd), "<script>"):
        frontier_runs.write(folder, metrics | {"train": train})
        assert trained.read_training_cost(folder) is None
    for text in ("[1]", '"a"', "{", "[" * 10**5):
        (folder / "metrics.json").write_text(text)
        assert trained.read_training_cost(folder) is None


def test_a_strangers_run_is_attacked_with_its_own_settings(tmp_path):
    own = ["scene={preset: screen_photo, view: {roll: [-3, 3]}}", "train.lr=1e-5", "data.val=null"]
    folder = put(tmp_path, *own)
    assert trained.read(folder).cfg == configured("recipe=clean", *TINY, f"runs={tmp_path}", *own)
    (folder / "metrics.json").write_text(json.dumps({"train": {"seconds": "<script>"}}))
    given = ["reattack.n=2", "reattack.eps=[0.01]", "reattack.steps=1", "data.val=16"]
    found = attack(folder, *given, "scene=paper_code")
    assert found["reattack"][0]["n"] == 2 and found["train"] is None
    assert found["scene_name"] == "paper_code"
    (path,) = folder.glob("reattack/*-paper_code-*/ladder/metrics.json")
    assert "oc.env" not in path.read_text()


def test_settings_in_our_own_runs_are_not_resolved_either(tmp_path, monkeypatch):
    monkeypatch.setenv("SECRET", "swordfish")
    folder = put(tmp_path, edit=lambda t: t.replace("weights: null", "weights: ${oc.env:SECRET}"))
    cfg = configured("recipe=clean", *TINY, f"runs={tmp_path}", "weights=swordfish")
    assert Run(cfg).stage() == "other", "else the variable was read"
    assert yaml.safe_load((folder / "config.yaml").read_text())["weights"] == "${oc.env:SECRET}"
    assert "stranger" not in sys.modules
