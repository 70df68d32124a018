"""What interrupts a run, and that the same command continues from the last whole epoch to the same
weights."""

import errno
import json
import os
import re
import resource
import shutil
import signal
import warnings
from dataclasses import replace

import pytest
import torch
import yaml
from lightning.pytorch.callbacks import ModelCheckpoint

from moireaug.common import files
from tests.conftest import THREADS
from tests.training.forked import Command
from tests.training.small import BRIEF, NO_DATA, TINY, configured, epoch, inside, same, train, wait
from tests.training.strangers import images
from training import fit
from training.attack import results
from training.attack.results import run_metrics
from training.classifier import train as training
from training.classifier.module import Classifier
from training.classifier.tuning import tuning_of
from training.runs import resume
from training.runs.run import Run
from training.trainer import make, ranks
from training.trainer.make import EpochLines

pytestmark = pytest.mark.usefixtures("as_the_command_is")

THREE_EPOCHS = ["recipe=moire_at", *TINY, "train.epochs=3", "train.init=random"]


def three_epochs(runs, *more):
    return configured(*THREE_EPOCHS, f"runs={runs}", *more)


@pytest.fixture(scope="module")
def straight(tmp_path_factory):
    """A run that nothing cut short, and its cost."""
    with warnings.catch_warnings(action="ignore"):
        torch.set_num_threads(THREADS)
        run, cost = train(three_epochs(tmp_path_factory.mktemp("straight")))
    return run.folder, cost


def test_a_stopped_and_killed_command_resumes_to_the_same_weights(tmp_path):
    given = ["recipe=clean", *TINY, *BRIEF, "data.workers=1", "train.epochs=10"]  # clean takes four
    folder = tmp_path / "runs/clean/seed0"
    stopped = Command("fit.py", *given, cwd=tmp_path, signal_at=(0, signal.SIGINT))
    out, _ = stopped.communicate()
    assert stopped.returncode == 130 and epoch(folder / "last.ckpt") == 0
    assert re.search("python .*training/fit.py recipe=clean", out) and "resume" not in out
    assert not (folder / "metrics.json").exists() and not (folder / "report.html").exists()

    killed = Command("fit.py", *given, cwd=tmp_path, signal_at=(1, signal.SIGSTOP))
    wait(killed, lambda: epoch(folder / "last.ckpt") == 1)
    cfg = configured(*given, f"runs={tmp_path / 'runs'}")
    with pytest.raises(ValueError, match="another command is at work"):
        fit.fit(cfg)
    killed.kill()
    killed.communicate()

    torch.set_num_threads(1)  # as the commands before
    done = inside("fit.py", *given, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "last.ckpt after 2 epochs." in done.stdout
    found = json.loads((folder / "metrics.json").read_text())
    assert [h["epoch"] for h in found["train"]["history"]] == list(range(4))
    whole, _ = train(configured(*given, f"runs={tmp_path / 'whole'}"))
    assert same(folder, whole.folder)


def test_an_epoch_whose_line_is_printed_has_been_kept(tmp_path):
    """Lightning calls callbacks in this order."""
    cfg = configured(*TINY)
    made = training.trainer_of(cfg.trainer, tuning_of(cfg.train, fine=False), 1, tmp_path, NO_DATA)
    *_, best, last, lines = made.callbacks
    assert isinstance(lines, EpochLines) and (best.filename, last.filename) == ("best", "last")


def test_a_full_disk_leaves_the_last_epoch_whole(tmp_path, monkeypatch, straight):
    cfg, real = three_epochs(tmp_path / "runs"), os.fsync
    folder = Run(cfg).folder

    def full(file):
        if epoch(folder / "last.ckpt") == 1:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(file)

    monkeypatch.setattr(files.os, "fsync", full)
    message = r"written \(No space left on device\): it needs .* MB are free"
    with pytest.raises(OSError, match=message):
        train(cfg)
    assert epoch(folder / "last.ckpt") == 1 and not list(folder.glob(".*"))
    monkeypatch.setattr(files.os, "fsync", real)
    shutil.move(folder, tmp_path / "larger_disk/moire_at/seed0")
    run, cost = train(three_epochs(tmp_path / "larger_disk"))
    assert same(run.folder, straight[0])
    assert [h["loss"] for h in cost.history] == [h["loss"] for h in straight[1].history]


def test_a_file_size_limit_leaves_no_half_written_file(tmp_path):
    """The kernel itself refuses to write on."""
    path, io = tmp_path / "last.ckpt", make.AtomicCheckpointIO()
    io.save_checkpoint({"state": torch.zeros(10)}, path)
    _, hard = limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, hard))
    try:
        with pytest.raises(OSError, match="could not be written"):
            io.save_checkpoint({"state": torch.ones(1_000_000)}, path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert torch.load(path)["state"].sum() == 0 and list(tmp_path.iterdir()) == [path]


def test_a_nan_loss_ends_at_the_last_whole_epoch(tmp_path, monkeypatch, straight):
    cfg, forward = three_epochs(tmp_path), Classifier.forward

    def broken(self, images):
        is_lost = self.training and self.current_epoch == 1
        return forward(self, images) * (float("nan") if is_lost else 1)

    monkeypatch.setattr(Classifier, "forward", broken)
    with pytest.raises(FloatingPointError, match="the loss became nan in epoch 2"):
        train(cfg)
    last = torch.load(Run(cfg).folder / "last.ckpt", weights_only=True)
    assert last["epoch"] == 0 and all(v.isfinite().all() for v in last["state_dict"].values())
    monkeypatch.setattr(Classifier, "forward", forward)
    assert same(train(cfg)[0].folder, straight[0])


def test_an_image_that_cannot_be_read_is_named(tmp_path):
    torn = images(tmp_path / "images", "a", "b") / "train/a/0.png"
    torn.write_bytes(torn.read_bytes()[:40])
    given = ["recipe=clean", *TINY[3:], "data=folder", f"data.root={tmp_path / 'images'}"]
    given += ["data.val=1", "data.workers=1", "train.batch_size=2"]
    failed = inside("fit.py", *given, cwd=tmp_path)
    assert failed.returncode == 1
    (said,) = [line for line in failed.stderr.splitlines() if "could not be read" in line]
    assert said.startswith(f"error: The image {torn} could not be read")
    assert "Traceback" not in failed.stderr and "Caught" not in failed.stderr


def test_only_an_interrupted_re_attack_is_done_again(tmp_path, monkeypatch, capsys):
    given = ["recipe=clean", *TINY, *BRIEF, f"runs={tmp_path}"]
    cfg, attack = configured(*given), results.attack
    folder = Run(cfg).folder

    def interrupt(*args, **settings):
        raise KeyboardInterrupt

    monkeypatch.setattr(results, "attack", interrupt)
    with pytest.raises(KeyboardInterrupt):
        fit.fit(cfg)
    train_json = json.loads((folder / "train.json").read_text())
    assert Run(cfg).stage() == "trained"
    monkeypatch.setattr(results, "attack", attack)
    monkeypatch.setattr(ranks, "fit", lambda *args: pytest.fail("trained again"))
    done = fit.fit(cfg)
    assert done["train"] == train_json and done["time"]["train"] == train_json["wall_seconds"]
    assert not (folder / "train.json").exists()

    monkeypatch.setattr(results, "attack", interrupt)
    again = configured(*given, "data.workers=1", "resume=true")
    assert fit.fit(again) == json.loads((folder / "metrics.json").read_text())
    assert "already finished; resume=false trains it again" in capsys.readouterr().out


def test_what_is_not_gone_on_with_is_moved_aside(tmp_path, capsys, straight):
    folder = shutil.copytree(straight[0], tmp_path / "moire_at/seed0")
    cfg = three_epochs(tmp_path, "resume=false")
    asides = []
    for _ in range(2):
        kept = (folder / "best.ckpt").read_bytes()
        Run(cfg).prepare()
        (aside,) = [p for p in folder.parent.glob("seed0-*") if p not in asides]
        assert (aside / "best.ckpt").read_bytes() == kept and not list(folder.iterdir())
        assert f"{folder} held this run; it is now {aside}" in capsys.readouterr().out
        shutil.copytree(aside, folder, dirs_exist_ok=True)
        asides.append(aside)
    cfg.resume = None
    Run(cfg).prepare()
    assert Run(cfg).can_resume() and len(list(folder.parent.glob("seed0*"))) == 3
    (folder / "config.yaml").write_text("recipe: [")
    Run(cfg).prepare()
    assert (folder.parent / "seed0-damaged/best.ckpt").is_file()
    shutil.copytree(straight[0], folder, dirs_exist_ok=True)
    Run(three_epochs(tmp_path, "train.lr=0.05")).prepare()  # a run with other settings
    assert not list(folder.iterdir()) and len(list(folder.parent.glob("seed0-*"))) == 4


def test_the_cost_of_deleted_weights_makes_no_other_training_look_complete(tmp_path, straight):
    """Checkpoints may be deleted for their space."""
    run = Run(three_epochs(tmp_path))
    folder = shutil.copytree(straight[0], run.folder)
    checkpoints = [folder / name for name in ("best.ckpt", "last.ckpt")]
    for path in checkpoints:
        path.unlink()
    run.prepare()
    for path in checkpoints:  # of a first epoch
        shutil.copy(straight[0] / path.name, path)
    assert run.stage() == "begun"


def test_resume_true_requires_something_to_resume(tmp_path, straight):
    shutil.copytree(straight[0], tmp_path / "moire_at/seed0")
    resume.require_resumable(Run(three_epochs(tmp_path, "resume=true")))
    for change, message in (
        ("train.lr=0.05", "was made with other settings"),
        ("seed=1", "does not exist: leave it out"),
    ):
        with pytest.raises(ValueError, match=message):
            resume.require_resumable(Run(three_epochs(tmp_path, "resume=true", change)))


def test_a_torn_checkpoint_gets_a_sentence(tmp_path, straight):
    last = shutil.copytree(straight[0], tmp_path / "moire_at/seed0") / "last.ckpt"
    last.write_bytes(last.read_bytes()[:5000])
    (last.parent / "train.json").unlink()
    with pytest.raises(ValueError, match=r"could not be read .* with resume=false"):
        train(three_epochs(tmp_path))


def test_a_moved_folder_knows_its_best_score(tmp_path):
    def after(kind, *name):
        old, new = (
            kind(tmp_path.joinpath(n, *name), monitor="val_score", mode="max") for n in "ab"
        )
        path = str(tmp_path / "a/best.ckpt")
        old.best_k_models = {path: torch.tensor(0.9)}
        old.best_model_path = old.kth_best_model_path = path
        new.load_state_dict(old.state_dict())
        return new.best_k_models

    kept = after(make.RunCheckpoint, "best.ckpt")
    assert kept == {str(tmp_path / "b/best.ckpt"): torch.tensor(0.9)}
    assert after(ModelCheckpoint) == {}, (
        "Lightning can do this by itself now: drop RunCheckpoint.load_state_dict"
    )


def test_a_run_of_before_a_setting_is_the_same_run(copied_run):
    """A setting that a run's files lack, as it is newer, has its default."""
    run, folder = copied_run
    config = yaml.safe_load((folder / "config.yaml").read_text())
    metrics = json.loads((folder / "metrics.json").read_text())
    for settings in (config, metrics["config"]):
        del settings["train"]["kept"], settings["reattack"]["bound"]
    (folder / "config.yaml").write_text(yaml.safe_dump(config))
    (folder / "metrics.json").write_text(json.dumps(metrics | {"fingerprint": "of then"}))
    assert run.stage() == "finished"
    metrics["config"]["reattack"]["n"] += 1
    (folder / "metrics.json").write_text(json.dumps(metrics))
    assert run.stage() == "trained"
    config["train"]["kept"] = 0.5
    (folder / "config.yaml").write_text(yaml.safe_dump(config))
    assert run.stage() == "other"


@pytest.fixture
def copied_run(tmp_path, straight):
    """A finished run, as far as its files say."""
    run = Run(three_epochs(tmp_path))
    shutil.copytree(straight[0], run.folder)
    run.write_settings()
    metrics = run_metrics(run.config, straight[1], None)
    replace(metrics, reattack=[]).write(run.folder)
    return run, run.folder


def test_the_place_of_a_published_data_set_and_the_device_are_no_identity(tmp_path):
    """A preempted job finds its staged data elsewhere."""
    one = ["recipe=moire_at", "data=cifar10", "data.root=/scratch/1"]
    other = [*one[:2], "data.root=/scratch/2", "trainer.accelerator=cpu"]
    runs = [Run(configured(*given)) for given in (one, other)]
    assert runs[0].training_fingerprint == runs[1].training_fingerprint
    assert runs[0].fingerprint == runs[1].fingerprint
    folders = [Run(configured("data=folder", f"data.root={place}")) for place in "ab"]
    assert folders[0].training_fingerprint != folders[1].training_fingerprint


def test_settings_without_effect_do_not_tell_runs_apart():
    idle = ["data.workers=2", "data.download=true", "runs=there", "resume=true"]
    marks = [Run(configured(*given)).fingerprint for given in ([], idle, ["data.train=7"])]
    assert marks[0] == marks[1] != marks[2]
