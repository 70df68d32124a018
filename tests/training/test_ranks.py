"""Processes of one run: the end of one is the end of all, in a sentence."""

import functools
import os
import re
import signal
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from lightning.pytorch.plugins.environments import SLURMEnvironment
from torch.distributed.launcher import api

from tests.training import rank_jobs
from tests.training.forked import Command
from tests.training.small import BRIEF, NO_DATA, TINY, configured, inside, wait
from training import fit
from training.classifier.train import classifier_of, train_model, trainer_of
from training.classifier.tuning import tuning_of
from training.config.checks import check_devices
from training.config.schema import Trainer
from training.data.load import load
from training.demoireing import fit as demoireing  # noqa: F401  # registers its settings with Hydra
from training.demoireing.train import module_of
from training.runs.run import Run
from training.system import messages, processes
from training.system.messages import status_of
from training.trainer import ranks
from training.trainer.make import EndOnSigterm

pytestmark = pytest.mark.usefixtures("as_the_command_is")


def test_a_run_ends_where_one_of_its_processes_is_lost(tmp_path):
    given = ["recipe=clean", *TINY, "train.epochs=300", "trainer.devices=2", "trainer.strategy=ddp"]
    process = Command("fit.py", *given, cwd=tmp_path, ranks="fork")
    wait(process, (tmp_path / "runs/clean/seed0/last.ckpt").is_file)
    os.kill(process.ranks()[1], signal.SIGKILL)
    _, err = process.communicate()
    assert process.returncode == 1 and err.count("another process of this run was lost") == 1
    assert "Traceback" not in err and "Warning" not in err


def test_a_worker_that_is_lost_gets_a_sentence(tmp_path):
    class Fatal(torch.utils.data.Dataset):
        def __len__(self):
            return 64

        def __getitem__(self, index):
            os.kill(os.getpid(), signal.SIGKILL)

    cfg = configured("recipe=clean", *TINY, "data.workers=1", f"runs={tmp_path}")
    Run(cfg).prepare()
    with pytest.raises(ConnectionError, match=r"another process of this run was lost"):
        train_model(Run(cfg), load(cfg.data)._replace(train=Fatal()))


@pytest.fixture
def forked(monkeypatch):
    """Let processes have what this one has imported."""
    launch_config = functools.partial(api.LaunchConfig, start_method="fork")
    monkeypatch.setattr(api, "LaunchConfig", launch_config)


@pytest.mark.usefixtures("forked")
def test_a_process_that_waits_for_a_lost_one_ends_too(tmp_path, capfd):
    with pytest.raises(ConnectionError, match="the same command resumes"):
        ranks.run_job(Trainer(accelerator="cpu", devices=2), rank_jobs.lose_one, tmp_path)
    for rank in "01":
        assert not Path("/proc", (tmp_path / rank).read_text()).exists()
    assert capfd.readouterr().err == ""


@pytest.mark.usefixtures("forked")
def test_of_several_processes_the_one_that_failed_first_speaks(tmp_path, monkeypatch, capfd):
    monkeypatch.setattr(messages, "SHOWS_TRACEBACKS", True)
    advice = "No space left on device.*: fix this, and resume with the same command"
    with pytest.raises(ranks.RankError, match=advice):
        ranks.run_job(Trainer(accelerator="cpu", devices=2), rank_jobs.fail_in_one, tmp_path)
    assert "in fail_in_one\n" in capfd.readouterr().err


def test_no_process_too_many_is_started(monkeypatch):
    """No more than there are cores, and none where a launcher has started them."""
    monkeypatch.setattr(ranks, "_launch", lambda *_: pytest.fail("processes were started"))
    with pytest.raises(ValueError, match=r"trainer.devices must be 1 to .* got 99999"):
        ranks.run_job(Trainer(accelerator="cpu", devices=99_999), print)
    monkeypatch.setenv("RANK", "1")
    monkeypatch.setenv("WORLD_SIZE", "2")
    done = []
    ranks.run_job(Trainer(accelerator="cpu", devices=2), done.append, "here")
    assert done == ["here"] and os.environ["RANK"] == "1"


# the environment, the processes of the run, and what a line says is ignored
LEFT_OVER = [
    ("RANK=1", 1, "RANK=1"),
    ("RANK=", 1, "RANK="),
    ("RANK=one WORLD_SIZE=2", 2, "RANK=one"),
    ("RANK=2 WORLD_SIZE=2", 2, "RANK=2"),
    ("RANK=1 LOCAL_RANK=1 WORLD_SIZE=4 TORCHELASTIC_RUN_ID=x", 2, "RANK=1 LOCAL_RANK=1"),
    ("RANK=0", 2, "RANK=0"),
    ("RANK=0", 1, None),  # which changes nothing
    ("SLURM_PROCID=3 SLURM_NTASKS=8 SLURM_LOCALID=3 SLURM_NTASKS_PER_NODE=8", 1, "SLURM_PROCID=3"),
    ("JSM_NAMESPACE_RANK=1 JSM_NAMESPACE_SIZE=6", 1, "JSM_NAMESPACE_RANK=1"),
]
LAUNCHED = [
    ("RANK=1 LOCAL_RANK=1 WORLD_SIZE=2 TORCHELASTIC_RUN_ID=x", 2),
    ("LOCAL_RANK=1 WORLD_SIZE=2", 2),  # by Lightning itself
    ("SLURM_PROCID=1 SLURM_NTASKS=2", 2),
    ("RANK=0 WORLD_SIZE=1", 1),
]


@pytest.fixture
def environment(monkeypatch):
    """Set the variables of a text, and no other of a launcher."""
    monkeypatch.setattr(processes.rank_zero_only, "rank", 1)

    def put(text):
        for launcher in processes.LAUNCHERS:
            for name in (*launcher.ranks, launcher.size, *launcher.others):
                monkeypatch.delenv(name, raising=False)
        for given in text.split():
            monkeypatch.setenv(*given.split("="))

    return put


@pytest.mark.parametrize(("text", "count", "ignored"), LEFT_OVER)
def test_variables_of_another_launch_are_ignored(text, count, ignored, environment, capsys):
    environment(text)
    assert not processes.join_launch(count) and processes.is_first()
    said = capsys.readouterr().out
    assert said.startswith(f"note: {ignored} in the environment is ignored" if ignored else "")
    assert bool(said) is (ignored is not None)
    assert os.environ.keys().isdisjoint(given.split("=")[0] for given in text.split())


@pytest.mark.parametrize(("text", "count"), LAUNCHED)
def test_variables_of_this_launch_are_left(text, count, environment, capsys):
    environment(text + " JSM_NAMESPACE_RANK=5")
    assert processes.join_launch(count) and processes.rank_zero_only.rank == 1
    assert " ".join(f"{name}={os.environ[name]}" for name in re.findall(r"\w+(?==)", text)) == text
    assert "JSM_NAMESPACE_RANK" not in os.environ
    assert capsys.readouterr().out.startswith("note: JSM_NAMESPACE_RANK=5 in the environment")


def test_a_run_of_one_process_reports_whatever_launched_its_shell(tmp_path, environment):
    environment("RANK=1 SLURM_PROCID=3 SLURM_NTASKS=8")
    done = inside("fit.py", "recipe=clean", *TINY, *BRIEF, cwd=tmp_path)
    assert done.returncode == 0 and "SLURM_PROCID=3 in the environment" in done.stdout
    assert (tmp_path / "runs/clean/seed0/report.html").is_file()


@pytest.mark.parametrize(("devices", "count"), [(2, 2), ("auto", 4), (-1, 4), ([0, 2], 2)])
def test_devices_are_counted(devices, count, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 4)
    check_devices(Trainer(devices=devices))
    assert ranks.device_count(Trainer(devices=devices)) == count
    assert ranks.device_count(Trainer(accelerator="cpu", devices="auto")) == 1
    for odd in ("two", "0,1", 5, -2, None):
        with pytest.raises(ValueError, match=rf"trainer.devices must be 1 to 4 GPUs, .* got {odd}"):
            check_devices(Trainer(devices=odd))


def test_a_terminated_process_sends_nothing_within_a_batch(tmp_path, monkeypatch):
    """The others may be sending gradients, and would wait for it for ever."""
    cfg = configured(*TINY, "trainer.devices=2")
    trainer = trainer_of(cfg.trainer, tuning_of(cfg.train, fine=False), 1, tmp_path, NO_DATA)
    monkeypatch.setattr(torch.distributed, "is_initialized", lambda: True)
    monkeypatch.setattr(torch.distributed, "broadcast", lambda *a, **k: pytest.fail("it was sent"))
    before = signal.getsignal(signal.SIGTERM)
    trainer._signal_connector.register_signal_handlers()
    for callback in trainer.callbacks:
        if isinstance(callback, EndOnSigterm):
            callback.on_train_start(trainer, None)
    with pytest.raises(KeyboardInterrupt) as end:
        signal.raise_signal(signal.SIGTERM)
    assert status_of(end.value) == 143 and status_of(KeyboardInterrupt()) == 130
    signal.signal(signal.SIGTERM, before)


def test_a_batch_that_processes_cannot_share_is_refused_first(tmp_path):
    given = ["trainer.devices=2", "train.batch_size=7", f"runs={tmp_path}"]
    with pytest.raises(ValueError, match=r"multiple of their number, 2; got 7. The nearest is 8"):
        fit.fit(configured("recipe=clean", *TINY, *given))
    assert not list(tmp_path.rglob("*.ckpt"))


def test_an_epoch_begins_with_the_statistics_of_the_first_process(monkeypatch):
    """DDP does not share them after a validation, and a resumed run has the first's."""
    sent = []
    monkeypatch.setattr(torch.distributed, "is_initialized", lambda: True)
    monkeypatch.setattr(torch.distributed, "broadcast", lambda *given: sent.append(given))
    classifier = classifier_of(configured(*TINY), 4)
    classifier.on_train_epoch_start()
    buffers = list(classifier.buffers())
    assert len(sent) == len(buffers) > 0
    for (buffer, source), own in zip(sent, buffers, strict=True):
        assert buffer is own and source == 0


def test_slurm_does_not_requeue_by_itself(tmp_path, monkeypatch):
    for name in ("NTASKS=1", "PROCID=0", "LOCALID=0", "NODEID=0", "JOB_ID=1"):
        monkeypatch.setenv(*f"SLURM_{name}".split("="))
    cfg = configured(*TINY)
    trainer = trainer_of(cfg.trainer, tuning_of(cfg.train, fine=False), 1, tmp_path, NO_DATA)
    environment = trainer._accelerator_connector.cluster_environment
    assert isinstance(environment, SLURMEnvironment) and not environment.auto_requeue


@pytest.mark.parametrize("recipe", ["clean", "demoire"])
def test_an_epochs_loss_is_that_of_all_processes(recipe, monkeypatch):
    if recipe == "demoire":
        module = module_of(configured(name="demoire"))
    else:
        module = classifier_of(configured(f"recipe={recipe}", *TINY), 4)
        module.figures = {"clean": [torch.ones(2)]}
    module._losses = [torch.tensor(1.0)]
    module._rng = torch.random.get_rng_state()
    strategy = SimpleNamespace(reduce=lambda value, reduce_op: value + 1)  # the other's is 3
    module._trainer = SimpleNamespace(strategy=strategy, current_epoch=0, global_step=1)
    module._training_seconds = 0.0
    monkeypatch.setattr(module, "log", lambda *args, **kwargs: None)
    module.on_validation_epoch_end()
    assert module.history[0]["loss"] == 2
