"""Jobs for processes of their own."""

import os
import signal
import time
from pathlib import Path

import torch
from torch.utils.data import DataLoader, TensorDataset

from training.runs.run import locked_folder


def lose_one(folder):
    """The second process is killed; the first waits for it, as on a GPU: nothing wakes it."""
    rank = os.environ["RANK"]
    (Path(folder) / rank).write_text(str(os.getpid()))
    while rank == "1" and not Path(folder, "0").exists():  # which may still be starting
        time.sleep(0.05)
    if rank == "1":
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(600)


def fail_in_one(folder):
    """The second process fails, and with that the first."""
    if os.environ["RANK"] == "1":
        raise OSError(28, "No space left on device", str(folder))
    raise ConnectionError("another process of this run was lost")


def fail():
    raise ValueError("of a bug")


def hold(folder, ready):
    """Lock a run's folder, start a worker, say so and wait."""
    with locked_folder(folder):
        data = TensorDataset(torch.zeros(8))
        loader = DataLoader(
            data, 1, num_workers=1, persistent_workers=True, multiprocessing_context="fork"
        )
        batches = iter(loader)
        next(batches)
        ready.set()
        time.sleep(600)
