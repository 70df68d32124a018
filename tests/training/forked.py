"""Commands in processes of their own, to be killed, stopped and shared, forked from a server that
has imported what a command imports for seconds."""

import multiprocessing
import os
import runpy
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
ALONE = {"OMP_NUM_THREADS": "1", "OMP_WAIT_POLICY": "passive", "PYTHONPATH": str(ROOT)}
LONG = 240  # seconds, for a busy machine

_forks = multiprocessing.get_context("forkserver")
_forks.set_forkserver_preload(["training.classifier.train", "training.fit", "training.reattack"])


class Command:
    """A script with its arguments in a new process; in use it is a `subprocess.Popen`."""

    def __init__(self, script, *overrides, cwd):
        self.args = [str(ROOT / "training" / script), *overrides]
        self._said = tempfile.TemporaryDirectory()
        self._process = _forks.Process(target=_run, args=(self.args, str(cwd), self._said.name))
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
            if "spawn_main" in Path(f"/proc/{child}/cmdline").read_text():
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


def _run(args, cwd, said):
    import torch

    # its own processes start as those of any script, not from the server, which outlives it
    multiprocessing.set_start_method(None, force=True)
    os.environ |= ALONE
    torch.set_num_threads(1)
    os.chdir(cwd)
    for number, name in ((1, "stdout"), (2, "stderr")):
        file = os.open(Path(said) / name, os.O_WRONLY | os.O_CREAT)
        os.dup2(file, number)
    sys.argv = list(args)
    runpy.run_path(args[0], run_name="__main__")
