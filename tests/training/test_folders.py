"""Each model and data set has folders of its own; a baseline that is damaged is trained again."""

import errno
import json
import os
from dataclasses import replace
from pathlib import Path

import pytest
from lightning.fabric.utilities.exceptions import MisconfigurationException

from tests.training import frontier_runs
from tests.training.small import TINY, baseline_config, configured, start_config
from tests.training.strangers import put
from training import fit
from training.attack.results import run_metrics
from training.classifier.train import train_model
from training.comparison.frame import read
from training.data.load import load
from training.recipe import phases
from training.runs import resume
from training.runs.run import Run

pytestmark = pytest.mark.usefixtures("as_the_command_is")


PATHS = {
    (): "runs/clean/seed0",
    ("recipe=moire_at", "seed=3", "runs=there"): "there/moire_at/seed3",
    ("model=resnet18",): "runs/resnet18/clean/seed0",
    ("data=cifar10", "model=resnet18"): "runs/cifar10-resnet18/clean/seed0",
    ("data=folder", "data.root='a b/..odd $name'"): "runs/folder-..odd_name/clean/seed0",
    ("data.size=32", "train.lr=0.05"): "runs/clean/seed0",
}


def test_models_and_data_do_not_share_a_folder():
    for given, path in PATHS.items():
        cfg = configured(*given)
        assert str(Run(cfg).folder) == path
        for other in (start_config(cfg), baseline_config(cfg)):
            assert other is None or Run(other).folder.parent.parent == Run(cfg).folder.parent.parent


def test_a_frontier_is_of_one_group_of_runs(tmp_path):
    for group in ("resnet18", "cifar10"):
        frontier_runs.put(tmp_path / group, "clean", 0)
    with pytest.raises(ValueError, match=r"pass one of \S+/cifar10, \S+/resnet18\."):
        read(tmp_path)
    for recipe in ("clean", "good"):
        frontier_runs.put(tmp_path, recipe, 0)
    assert len(read(tmp_path).runs) == 2
    assert len(read(tmp_path / "resnet18").runs) == 1


TORN = [(torn, "start", "clean") for torn in ("best.ckpt", "last.ckpt", "config.yaml")]


@pytest.mark.parametrize(("torn", "role", "recipe"), [*TORN, ("metrics.json", *2 * ["baseline"])])
def test_a_damaged_baseline_is_trained_again(torn, role, recipe, tmp_path, monkeypatch, capsys):
    wanted = configured(f"recipe={recipe}", *TINY, f"runs={tmp_path}")
    folder = put(tmp_path, f"recipe={recipe}")
    metrics = run_metrics(wanted, frontier_runs.cost(1.0, "random"), None)
    metrics.write(folder)
    (folder / "last.ckpt").write_bytes((folder / "best.ckpt").read_bytes())
    assert resume.damage(Run(wanted)) is None
    if torn == "metrics.json":  # of another version
        (folder / torn).write_text(json.dumps({"version": 0}))
    else:
        path = folder / torn
        path.write_bytes(path.read_bytes()[:40])
    runs = []
    result = None, metrics.train
    monkeypatch.setattr(phases, "train_run", lambda run, *rest: runs.append(run) or result)
    phases.plain_run(Run(wanted), load(wanted.data), None, role=role)
    if torn == "last.ckpt":  # which no finished run needs
        assert not runs and f"The {role} is reused from {folder}." in capsys.readouterr().out
        return
    assert len(runs) == 1
    assert f"The {role} cannot be reused and is trained again: " in capsys.readouterr().out
    assert runs[0].config.resume is False and runs[0].config.recipe == recipe
    runs[0].prepare()
    assert not any(folder.iterdir())
    assert len(list(folder.parent.glob("seed0-*"))) == 1, "nothing is lost"


@pytest.fixture
def finished(tmp_path):
    """A finished run, as far as its files say."""
    run = Run(configured("recipe=clean", *TINY, f"runs={tmp_path}"))
    folder = put(tmp_path)
    metrics = run_metrics(run.config, frontier_runs.cost(1.0, "random"), None)
    replace(metrics, reattack=[]).write(folder)
    assert run.stage() == "finished"
    return run


@pytest.mark.parametrize("name", ["config.yaml", "metrics.json"])
def test_a_failed_read_moves_and_deletes_nothing(name, finished, monkeypatch):
    read_text = Path.read_text

    def fail(path, **settings):
        if path.name == name:
            raise OSError(errno.EIO, os.strerror(errno.EIO), str(path))
        return read_text(path, **settings)

    (finished.folder / "last.ckpt").touch()
    with monkeypatch.context() as patch:
        patch.setattr(Path, "read_text", fail)
        with pytest.raises(OSError, match=os.strerror(errno.EIO)):
            finished.prepare()
    assert finished.stage() == "finished"
    assert [path.name for path in finished.folder.parent.iterdir()] == ["seed0"]


def test_a_failed_read_of_a_checkpoint_is_no_damage(finished, monkeypatch):
    def fail(path):
        raise OSError(errno.ESTALE, os.strerror(errno.ESTALE), str(path))

    monkeypatch.setattr(Path, "read_bytes", fail)
    with pytest.raises(OSError, match=os.strerror(errno.ESTALE)):
        resume.damage(finished)


DEEP = f"scene: {'[' * 300}{']' * 300}"
BEYOND_FLOATS = f"train: {{momentum: 1{'0' * 400}}}"
WRONG_VALUES = ["data: 3", "nothing: 3", "seed: !!int ''", "seed: !!timestamp x"]


@pytest.mark.parametrize("text", [*WRONG_VALUES, "1: 2", "- a", "\0", DEEP, BEYOND_FLOATS])
def test_settings_that_are_no_runs_are_of_another_training(text, finished):
    (finished.folder / "config.yaml").write_text(text)
    assert finished.stage() == "other"


@pytest.mark.parametrize("config", [None, 3, "text", [], {}, {"data": 3}, {"nothing": 3}])
def test_metrics_whose_settings_are_no_runs_are_of_another_test(config, finished):
    path = finished.folder / "metrics.json"
    metrics = json.loads(path.read_text())
    path.write_text(json.dumps(metrics | {"config": config}))
    assert finished.stage() == "trained"
    del metrics["config"]
    path.write_text(json.dumps(metrics))
    assert finished.stage() == "trained"


def test_a_setting_that_cannot_be_used_moves_no_run(tmp_path):
    run = tmp_path / "clean/seed0"
    run.mkdir(parents=True)
    (run / "best.ckpt").write_bytes(b"of a run with other settings")
    for section, name, value in (
        (None, "weights", "none.pt"),
        ("trainer", "precision", "8"),
        ("trainer", "strategy", "foo"),
        ("reattack", "eps", [0.01, 0.01]),
    ):
        cfg = configured("recipe=clean", *TINY, f"runs={tmp_path}")
        setattr(getattr(cfg, section) if section else cfg, name, value)
        with pytest.raises((ValueError, MisconfigurationException)):
            fit.fit(cfg)
        assert [path.name for path in run.iterdir()] == ["best.ckpt"], name
        assert [path.name for path in run.parent.iterdir() if path.name[0] != "."] == ["seed0"]


@pytest.mark.parametrize(
    ("there", "whole", "taken"),
    [
        (["reattack.n=12"], True, True),
        (["train.epochs=3"], True, False),
        (["data.size=32"], True, False),
        ([], False, False),  # trained again by another command
    ],
)
def test_a_start_that_another_command_has_replaced_is_not_taken(there, whole, taken, tmp_path):
    """The weights of a start are read only where it was trained with this run's settings."""
    put(tmp_path, "recipe=clean", "train.epochs=1", *there)
    (tmp_path / "clean/seed0/metrics.json").write_text("{}" if whole else "")
    cfg = configured("recipe=baseline", *TINY, "train.epochs=1", f"runs={tmp_path}")
    Run(cfg).prepare()
    if taken:
        train_model(Run(cfg), load(cfg.data))
        return
    with pytest.raises(ValueError, match="no longer holds the run that was trained there"):
        train_model(Run(cfg), load(cfg.data))
