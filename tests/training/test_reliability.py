"""What interrupts a run, and that the same command continues from the last whole epoch to the same
weights."""

import errno
import json
import os
import re
import resource
import shutil
import signal

import pytest
import torch
from lightning.pytorch.callbacks import ModelCheckpoint
from torchvision.io import write_png

from moireaug import files
from tests.conftest import THREADS
from tests.training.forked import Command
from tests.training.small import (
    BRIEF,
    NO_DATA,
    TINY,
    configured,
    epoch,
    inside,
    same,
    train,
    wait,
    weights,
)
from training import fit
from training.classifier import train as training
from training.classifier.module import Classifier
from training.classifier.train import train_model
from training.classifier.tuning import tuning_of
from training.data.load import load
from training.recipe import phases
from training.runs import resume
from training.runs.identity import fingerprint_of, result_settings
from training.runs.run import Run
from training.trainer import checkpoints
from training.trainer.make import EpochLines

pytestmark = pytest.mark.usefixtures("as_the_command_is")


@pytest.fixture(scope="module")
def straight(tmp_path_factory):
    """A run that nothing cut short."""
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.set_num_threads(THREADS)
        return train(tmp_path_factory.mktemp("straight"), "runs")


def test_a_stopped_and_killed_command_resumes_to_the_same_weights(tmp_path):
    given = ["recipe=clean", *TINY, *BRIEF, "train.epochs=40", "data.workers=1"]  # clean takes 16
    folder = tmp_path / "runs/clean/seed0"
    process = Command("fit.py", *given, cwd=tmp_path)
    wait(process, folder / "last.ckpt", 1)
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate()
    assert process.returncode == 130
    assert re.search("python .*training/fit.py recipe=clean", out) and "resume" not in out
    assert not (folder / "metrics.json").exists() and not (folder / "report.html").exists()

    kept = epoch(folder / "last.ckpt")
    process = Command("fit.py", *given, cwd=tmp_path)
    wait(process, folder / "last.ckpt", kept + 1)
    process.send_signal(signal.SIGSTOP)
    cfg = configured(*given, f"runs={tmp_path / 'runs'}")
    with pytest.raises(ValueError, match="another command is at work"):
        fit.fit(cfg)
    kept = epoch(folder / "last.ckpt")
    assert kept < 15, "nothing was left to go on with"
    process.kill()
    process.communicate()

    torch.set_num_threads(1)  # as the commands before
    done = inside("fit.py", *given, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert f"last.ckpt after {kept + 1} epochs." in done.stdout
    found = json.loads((folder / "metrics.json").read_text())
    assert [h["epoch"] for h in found["train"]["history"]] == list(range(16))
    whole = configured(*given, f"runs={tmp_path / 'whole'}")
    Run(whole).prepare()
    train_model(Run(whole), load(whole.data))
    assert same(folder, Run(whole).folder)


def test_an_epoch_whose_line_is_printed_has_been_kept(tmp_path):
    """Lightning calls callbacks in this order."""
    cfg = configured(*TINY)
    made = training.trainer_of(cfg.trainer, tuning_of(cfg.train, fine=False), 1, tmp_path, NO_DATA)
    *_, best, last, lines = made.callbacks
    assert isinstance(lines, EpochLines) and (best.filename, last.filename) == ("best", "last")


def test_a_full_disk_leaves_the_last_epoch_whole(tmp_path, monkeypatch, straight):
    real = os.fsync

    def full(file):
        if epoch(tmp_path / "runs/moire_at/seed0/last.ckpt") == 1:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(file)

    monkeypatch.setattr(files.os, "fsync", full)
    with pytest.raises(
        OSError, match=r"written \(No space left on device\): it needs .* MB are free"
    ):
        train(tmp_path, "runs")
    folder = tmp_path / "runs/moire_at/seed0"
    assert epoch(folder / "last.ckpt") == 1 and not list(folder.glob(".*"))
    monkeypatch.setattr(files.os, "fsync", real)
    shutil.move(folder, tmp_path / "elsewhere/moire_at/seed0")  # a larger disk
    out, found = train(tmp_path, "elsewhere")
    assert same(out, straight[0])
    assert [h["loss"] for h in found.history] == [h["loss"] for h in straight[1].history]


def test_a_file_size_limit_leaves_no_half_written_file(tmp_path):
    """The kernel itself refuses to write on."""
    path, io = tmp_path / "last.ckpt", checkpoints.AtomicCheckpointIO()
    io.save_checkpoint({"state": torch.zeros(10)}, path)
    _, hard = limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, hard))
    try:
        with pytest.raises(OSError, match="could not be written"):
            io.save_checkpoint({"state": torch.ones(1_000_000)}, path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert torch.load(path)["state"].sum() == 0 and [p.name for p in tmp_path.iterdir()] == [
        "last.ckpt"
    ]


def test_a_nan_loss_ends_at_the_last_whole_epoch(tmp_path, monkeypatch, straight):
    forward = Classifier.forward

    def broken(self, images):
        return forward(self, images) * (
            float("nan") if self.training and self.current_epoch == 1 else 1
        )

    monkeypatch.setattr(Classifier, "forward", broken)
    with pytest.raises(FloatingPointError, match="the loss became nan in epoch 2"):
        train(tmp_path, "runs")
    folder = tmp_path / "runs/moire_at/seed0"
    assert epoch(folder / "last.ckpt") == 0
    assert all(v.isfinite().all() for v in weights(folder / "last.ckpt").values())
    monkeypatch.setattr(Classifier, "forward", forward)
    assert same(train(tmp_path, "runs")[0], straight[0])


def test_an_image_that_cannot_be_read_is_named(tmp_path):
    paths = [f"{half}/{c}/{k}.png" for half in ("train", "test") for c in "ab" for k in range(12)]
    for k, path in enumerate(tmp_path / "images" / path for path in paths):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_png(torch.full((3, 20, 20), 5 * k, dtype=torch.uint8), str(path))
    torn = tmp_path / "images" / paths[3]
    whole = torn.read_bytes()
    torn.write_bytes(whole[:40])
    given = ["recipe=clean", *TINY[3:], *BRIEF, "data=folder", f"data.root={tmp_path / 'images'}"]
    given += ["data.val=4", "data.workers=1", "train.batch_size=8", "train.length=1.0"]
    failed = inside("fit.py", *given, cwd=tmp_path)
    assert failed.returncode == 1
    (said,) = [line for line in failed.stderr.splitlines() if "could not be read" in line]
    assert said.startswith(f"error: The image {torn} could not be read")
    assert "Traceback" not in failed.stderr and "Caught" not in failed.stderr
    torn.write_bytes(whole)
    done = fit.fit(configured(*given, f"runs={tmp_path / 'runs'}"))
    assert done["train"]["epochs"] == 2


def test_only_an_interrupted_re_attack_is_done_again(tmp_path, monkeypatch, capsys):
    cfg = configured("recipe=clean", *TINY, *BRIEF, f"runs={tmp_path}")
    folder, attack = Run(cfg).folder, phases.attack

    def interrupt(*args, **settings):
        raise KeyboardInterrupt

    monkeypatch.setattr(phases, "attack", interrupt)
    with pytest.raises(KeyboardInterrupt):
        fit.fit(cfg)
    train_json = json.loads((folder / "train.json").read_text())
    assert Run(cfg).stage() == "trained"
    monkeypatch.setattr(phases, "attack", attack)
    monkeypatch.setattr(training.ranks, "fit", lambda *args: pytest.fail("trained again"))
    done = fit.fit(cfg)
    assert done["train"] == train_json and done["time"]["train"] == train_json["wall_seconds"]
    assert not (folder / "train.json").exists()

    monkeypatch.setattr(phases, "attack", interrupt)
    again = configured(
        "recipe=clean", *TINY, *BRIEF, f"runs={tmp_path}", "data.workers=1", "resume=true"
    )
    assert fit.fit(again) == json.loads((folder / "metrics.json").read_text())
    assert "already finished; resume=false trains it again" in capsys.readouterr().out


def test_what_is_not_gone_on_with_is_moved_aside(tmp_path, capsys, straight):
    shutil.copytree(straight[0], tmp_path / "moire_at/seed0")
    given = ["recipe=moire_at", *TINY, "train.epochs=3", "train.init=random", f"runs={tmp_path}"]
    cfg, folder = configured(*given, "resume=false"), tmp_path / "moire_at/seed0"
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
    Run(configured(*given, "train.lr=0.05")).prepare()  # a run with other settings
    assert not list(folder.iterdir()) and len(list(folder.parent.glob("seed0-*"))) == 4


def test_resume_true_requires_something_to_resume(tmp_path, straight):
    shutil.copytree(straight[0], tmp_path / "moire_at/seed0")
    given = ["recipe=moire_at", *TINY, "train.epochs=3", "train.init=random", "resume=true"]
    given.append(f"runs={tmp_path}")
    resume.require_resumable(Run(configured(*given)))
    with pytest.raises(ValueError, match="was made with other settings"):
        resume.require_resumable(Run(configured(*given, "train.lr=0.05")))
    with pytest.raises(ValueError, match="does not exist: leave it out"):
        resume.require_resumable(Run(configured(*given, "seed=1")))


def test_a_torn_checkpoint_gets_a_sentence(tmp_path, straight):
    shutil.copytree(straight[0], tmp_path / "runs/moire_at/seed0")
    last = tmp_path / "runs/moire_at/seed0/last.ckpt"
    last.write_bytes(last.read_bytes()[:5000])
    (last.parent / "train.json").unlink()
    with pytest.raises(ValueError, match=r"could not be read .* with resume=false"):
        train(tmp_path, "runs")


def test_a_moved_folder_knows_its_best_score(tmp_path):
    def after(kind, **settings):
        old, new = (
            kind(tmp_path / n, monitor="val_score", mode="max", **settings) for n in ("old", "new")
        )
        path = str(tmp_path / "old/best.ckpt")
        old.best_k_models, old.best_model_path, old.kth_best_model_path = (
            {path: torch.tensor(0.9)},
            path,
            path,
        )
        new.load_state_dict(old.state_dict())
        return new.best_k_models

    keep = after(lambda folder, **settings: checkpoints.RunCheckpoint(folder, "best", **settings))
    assert keep == {str(tmp_path / "new/best.ckpt"): torch.tensor(0.9)}
    assert after(ModelCheckpoint) == {}, (
        "Lightning can do this by itself now: drop RunCheckpoint.load_state_dict"
    )


def test_settings_without_effect_do_not_tell_runs_apart():
    def mark(*given):
        return fingerprint_of(result_settings(configured(*given)))

    assert mark() == mark("data.workers=2", "data.download=true", "runs=there", "resume=true")
    assert mark() != mark("data.train=7")
