"""A run's folder belongs to one command at a time, and what is said where the system refuses."""

import errno
import os
from pathlib import Path

import pytest
from filelock import FileLock

from tests.training import rank_jobs
from tests.training.forked import LONG, forks
from training.runs.run import locked_folder
from training.system import messages


def test_a_killed_command_frees_its_folder_though_workers_live_on(tmp_path):
    folder = tmp_path / "runs/clean/seed0"
    ready = forks.Event()
    process = forks.Process(target=rank_jobs.hold, args=(folder, ready))
    process.start()
    assert ready.wait(LONG)
    workers = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    with pytest.raises(ValueError, match="another command is at work"), locked_folder(folder):
        pass
    process.kill()
    process.join(LONG)
    with locked_folder(folder):
        alive = [pid for pid in workers if Path(f"/proc/{pid}").exists()]
    assert alive, "the worker ended before the folder was taken: this shows nothing"


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
