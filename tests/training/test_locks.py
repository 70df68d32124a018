"""A run's folder belongs to one command at a time, and what is said where the system refuses."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest
from filelock import FileLock

from tests.training.small import LONG, ROOT
from training.runs.run import locked_folder
from training.system import messages

HOLDER = """
import sys, time
from pathlib import Path
import torch
from torch.utils.data import DataLoader, TensorDataset
from training.runs.run import locked_folder
with locked_folder(Path(sys.argv[1])):
    data = TensorDataset(torch.zeros(8))
    loader = DataLoader(
        data, 1, num_workers=1, persistent_workers=True, multiprocessing_context="fork"
    )
    batches = iter(loader)
    next(batches)
    print("held", flush=True)
    time.sleep(600)
"""


def test_a_killed_command_frees_its_folder_though_workers_live_on(tmp_path):
    folder = tmp_path / "runs/clean/seed0"
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(folder)],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
    )
    assert process.stdout.readline() == b"held\n"
    workers = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    with pytest.raises(ValueError, match="another command is at work"), locked_folder(folder):
        pass
    process.kill()
    process.wait(LONG)
    with locked_folder(folder):
        alive = [pid for pid in workers if Path(f"/proc/{pid}").exists()]
    assert alive, "the worker ended before the folder was taken: this shows nothing"
    process.stdout.close()


def test_a_disk_without_locks_is_worked_on_without_one(tmp_path, monkeypatch):
    def refuse(number):
        def acquire(self):
            raise OSError(number, os.strerror(number))

        monkeypatch.setattr(FileLock, "_acquire", acquire)

    refuse(errno.ENOLCK)
    with locked_folder(tmp_path / "seed0"):
        pass
    refuse(errno.EROFS)
    with pytest.raises(OSError, match="Read-only"), locked_folder(tmp_path / "seed0"):
        pass


def test_the_systems_own_errors_say_how_to_go_on():
    full = messages.sentence(OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "runs/report.html"))
    assert "No space left" in full
    assert "runs/report.html" in full
    assert "resume with the same command" in full
    caught = ValueError("Caught ValueError in\n  File\nValueError: this.\n")
    assert messages.sentence(caught) == "this."
    assert messages.sentence(ValueError("this.")) == "this."
