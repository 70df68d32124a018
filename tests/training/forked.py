"""Commands in processes of their own, to be killed, stopped and shared, forked from a server that
has imported what a command imports for seconds."""

import functools
import multiprocessing
import os
import pickle
import runpy
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
ALONE = {"OMP_NUM_THREADS": "1", "OMP_WAIT_POLICY": "passive", "PYTHONPATH": str(ROOT)}
LONG = 240  # seconds, for a busy machine

forks = multiprocessing.get_context("forkserver")
forks.set_forkserver_preload(
    ["training.classifier.train", "training.fit", "training.reattack", "moireaug.engine.cpu.run"]
)


class Command:
    """A script with its arguments in a new process; in use it is a `subprocess.Popen`.

    Args:
        ranks: how its own processes start: by "spawn", as a user's, or quickly, by "fork".
        signal_at: (epoch, signal): it gets that signal once that epoch is kept.
    """

    def __init__(self, script, *overrides, cwd, ranks="spawn", signal_at=None):
        self.args = [str(ROOT / "training" / script), *overrides]
        self._said = tempfile.TemporaryDirectory()
        given = self.args, str(cwd), self._said.name, ranks, signal_at
        self._process = forks.Process(target=_run, args=given)
        self._process.start()
        self.pid = self._process.pid

    @property
    def returncode(self):
        return self._process.exitcode

    def ranks(self):
        """Return the numbers of the processes that share its work, in their order."""
        children = Path(f"/proc/{self.pid}/task/{self.pid}/children").read_text().split()
        workers = []
        for child in map(int, children):
            if "resource_tracker" not in Path(f"/proc/{child}/cmdline").read_text():
                workers.append(child)
        return sorted(workers)

    def poll(self):
        return self.returncode

    def send_signal(self, number):
        os.kill(self.pid, number)

    def kill(self):
        self._process.kill()

    def communicate(self):
        """Wait for its end; return what it wrote to its output and to its errors."""
        self._process.join(LONG)
        if self.returncode is None:
            self.kill()
            raise subprocess.TimeoutExpired(self.args, LONG)
        with self._said as folder:
            return [(Path(folder) / name).read_text() for name in ("stdout", "stderr")]


def _run(args, cwd, said, ranks, signal_at):
    import torch

    # its own processes start as those of any script, not from the server, which outlives it
    multiprocessing.set_start_method(None, force=True)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # which jobs in the background ignore
    if ranks == "fork":
        _fork_ranks()
    if signal_at:
        _signal_at(*signal_at)
    os.environ |= ALONE
    torch.set_num_threads(1)
    os.chdir(cwd)
    for number, name in ((1, "stdout"), (2, "stderr")):
        file = os.open(Path(said) / name, os.O_WRONLY | os.O_CREAT)
        os.dup2(file, number)
    sys.argv = list(args)
    runpy.run_path(args[0], run_name="__main__")


def _signal_at(epoch, number):
    from training.trainer.make import AtomicCheckpointIO

    save = AtomicCheckpointIO.save_checkpoint

    def save_checkpoint(self, checkpoint, path, storage_options=None):
        save(self, checkpoint, path, storage_options)
        if Path(path).name == "last.ckpt" and checkpoint["epoch"] == epoch:
            os.kill(os.getpid(), number)

    AtomicCheckpointIO.save_checkpoint = save_checkpoint


def _fork_ranks():
    from torch.distributed.launcher import api

    from training.system.processes import rank_zero_only
    from training.trainer import ranks

    run_rank = ranks._run_rank

    def run(*job):
        pickle.dumps(job)  # as it is for a process that is spawned
        rank_zero_only.rank = int(os.environ["RANK"])  # which Lightning has read, and not again
        run_rank(*job)

    ranks._run_rank = run
    api.LaunchConfig = functools.partial(api.LaunchConfig, start_method="fork")
