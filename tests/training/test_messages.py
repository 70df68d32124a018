"""Errors of the commands stand on lines of their own, each a sentence; disks are tried first."""

import errno
import io
import multiprocessing.synchronize
import os
import sys
import tempfile

import pytest
from torch._utils import ExceptionWrapper
from tqdm import tqdm

from moireaug.synthesis.pictures import NoPictureError
from tests.training import rank_jobs
from tests.training.small import TINY, command, configured, inside
from tests.training.strangers import attack, put
from training import fit
from training.attack import subject
from training.config import plain_commands
from training.recipe import phases
from training.system import messages
from training.system.messages import sentence

pytestmark = pytest.mark.usefixtures("as_the_command_is")


@pytest.mark.parametrize("stream", ["stdout", "stderr"])
def test_an_error_begins_a_line_below_a_progress_bar(stream, monkeypatch):
    out, err = io.StringIO(), io.StringIO()
    monkeypatch.setattr(sys, "stdout", messages.LineStream(out))
    monkeypatch.setattr(sys, "stderr", messages.LineStream(err))
    messages.print_error("error: first")
    assert err.getvalue() == "error: first\n" and not out.getvalue()
    bar = tqdm(total=3, file=getattr(sys, stream), leave=False, mininterval=0)
    bar.update()
    messages.print_error("error: second")
    lines = [file.getvalue().count("\n") for file in (out, err)]
    assert lines == ([1, 2] if stream == "stdout" else [0, 3])
    assert "error: second" in err.getvalue().split("\n")
    bar.close()
    messages.print_error("error: third")
    assert "error: third" in err.getvalue().split("\n")


def test_a_file_where_a_folder_should_be_gets_a_sentence(tmp_path):
    (tmp_path / "there").touch()
    for given in (("fit.py", "-m", "recipe=clean"), ("reattack.py", "model=vgg11", "weights=FILE")):
        failed = inside(*given, "runs=there", cwd=tmp_path)
        assert failed.returncode == 1 and "Traceback" not in failed.stderr
        assert any(line.startswith("error: there") for line in failed.stderr.split("\n"))
        assert "cannot be a folder: there is a file of that name" in failed.stderr


@pytest.mark.parametrize("number", [errno.EROFS, errno.EACCES])
def test_a_disk_that_takes_nothing_is_found_before_the_work(number, tmp_path, monkeypatch):
    def refuse(dir):
        raise OSError(number, os.strerror(number))

    folder = put(tmp_path)
    for module in (phases, subject):
        monkeypatch.setattr(module, "load", lambda *args: pytest.fail("time was spent"))
    monkeypatch.setattr(tempfile, "TemporaryFile", refuse)
    message = rf"cannot be written \({os.strerror(number)}\)"
    with pytest.raises(ValueError, match=message):
        fit.fit(configured("recipe=clean", *TINY, f"runs={tmp_path / 'new'}"))
    with pytest.raises(ValueError, match=message):
        attack(folder)


@pytest.mark.parametrize("kind", [ValueError, NoPictureError])
def test_what_a_worker_says_is_told_without_its_traceback(kind):
    with pytest.raises(kind) as error:
        try:
            raise kind("none: of them.")
        except kind:
            ExceptionWrapper(where="in DataLoader worker process 0").reraise()
    assert "Traceback" in str(error.value) and sentence(error.value) == "none: of them."


@pytest.mark.parametrize("asked", ["1", "0"])
def test_a_traceback_is_printed_where_it_is_asked_for(asked, tmp_path, monkeypatch):
    """Of a job of Hydra, which sets the same variable itself."""
    monkeypatch.setenv("HYDRA_FULL_ERROR", asked)
    failed = command("fit.py", "recipe=clean", "train.epochs=0", cwd=tmp_path)
    assert failed.returncode == 1
    assert failed.stderr.endswith(
        "\nerror: train.epochs must be at least 1; got 0.\n"[asked == "0" :]
    )
    assert ("Traceback" in failed.stderr and "_check_number" in failed.stderr) == (asked == "1")


def test_every_command_prints_tracebacks(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(messages, "SHOWS_TRACEBACKS", True)
    with pytest.raises(SystemExit, match="error: of a bug"), plain_commands.report_errors(""):
        rank_jobs.fail()
    assert "in fail\n" in capsys.readouterr().err
    refused = inside("fit.py", "recipe=clean", "train.epoch=1", cwd=tmp_path)
    assert "Traceback" in refused.stderr and "error: " in refused.stderr


@pytest.mark.parametrize("end", [" 7) is killed by signal: Killed.", "(s) 7) exited unexpectedly"])
def test_a_lost_worker_of_any_command_gets_a_sentence(end):
    said = pytest.raises(SystemExit, match="error: a worker process was lost: it was killed")
    with said, plain_commands.report_errors("Interrupted."):
        raise RuntimeError(f"DataLoader worker (pid{end}")


BUS_ERROR = (
    "DataLoader worker (pid 7) is killed by signal: Bus error. It is possible that dataloader's "
    "workers are out of shared memory. Please try to raise your shared memory limit."
)


@pytest.mark.parametrize(
    ("error", "lacks"),
    [
        (RuntimeError("unable to allocate shared memory(shm) for file </torch_1>: No space"), True),
        (RuntimeError(BUS_ERROR), True),
        (OSError(errno.ENOSPC, "No space left on device"), False),  # of a disk
        (RuntimeError("DataLoader worker (pid 7) is killed by signal: Killed."), False),
    ],
)
def test_a_lack_of_shared_memory_says_what_to_set(error, lacks):
    assert messages.lacks_shared_memory(error) is lacks
    if lacks:
        assert messages.is_expected(error) and "--shm-size" in sentence(error)
        later = RuntimeError("Please call `iter(combined_loader)` first.")
        later.__context__ = error  # as Lightning raises
        assert sentence(later) == sentence(error)
        said = pytest.raises(SystemExit, match="error: the workers ran out of shared memory")
        with said, plain_commands.report_errors("Interrupted."):
            raise error


def test_a_semaphore_without_shared_memory_is_told_from_a_full_disk(monkeypatch):
    def refuse(*args):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(multiprocessing.synchronize._multiprocessing, "SemLock", refuse, False)
    with pytest.raises(OSError) as semaphore:
        multiprocessing.get_context("spawn").Lock()
    assert messages.lacks_shared_memory(semaphore.value)
    with pytest.raises(OSError) as disk:
        refuse()
    assert not messages.lacks_shared_memory(disk.value)
