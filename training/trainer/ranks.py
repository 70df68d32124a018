"""The processes of a run: if one is lost, all end, and one reports it."""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import lightning as L
from lightning.fabric.strategies.launchers import subprocess_script as fabric_script
from lightning.pytorch.plugins.environments import LightningEnvironment
from lightning.pytorch.strategies.launchers import subprocess_script
from torch.distributed import DistError

from training.system.messages import complain
from training.system.processes import wait_long

LOST_PROCESS = (
    "another process of this run was lost: it was killed, ran out of memory, or failed with the "
    "error above. What is complete is kept, and the same command resumes from there."
)
POLL_SECONDS = 0.5  # between looks at the other processes
GRACE_SECONDS = 5.0  # for a process to notice by itself, and clean up
_LOST_PATTERN = r"gloo|DataLoader worker \(pid"  # in the messages of plain RuntimeErrors
_children: list[subprocess.Popen] = []
_ending = threading.Event()


def fit(
    trainer: L.Trainer,
    module: L.LightningModule,
    batches: L.LightningDataModule,
    checkpoint: Path | None,
) -> None:
    """Train, with the processes of the run tied together.

    Args:
        checkpoint: to resume training from; None starts it.

    Raises:
        ConnectionError: another process was lost.
        KeyboardInterrupt: Ctrl-C or SIGTERM.
    """
    try:
        with tied_together(trainer):
            trainer.fit(module, batches, ckpt_path=checkpoint)
    except SystemExit:  # what Lightning makes of Ctrl-C and of SIGTERM
        raise KeyboardInterrupt from None


@contextlib.contextmanager
def tied_together(trainer: L.Trainer) -> Iterator[None]:
    """Tie the training processes together: none outlives the others, or waits for a lost one.

    Raises:
        ConnectionError: another process was lost.
    """
    _ending.clear()  # of another job of the same sweep
    # Lightning's observer kills this process without a message
    subprocess_script._launch_process_observer = _observe  # type: ignore[assignment]
    # SIGTERM is noted, and ends this process after its batch. Lightning's handler also broadcasts
    # it, in the middle of what the processes are sending: they would wait for each other for ever.
    signals = trainer._signal_connector
    signals._sigterm_notifier_fn = lambda *_: setattr(signals, "received_sigterm", True)  # type: ignore[method-assign]
    _follow_parent(trainer.strategy, trainer.local_rank)
    try:
        yield
    except BaseException as error:
        _ending.set()
        for child in _children:
            child.kill()
        _children.clear()
        if isinstance(error, RuntimeError) and (
            isinstance(error, DistError) or re.search(_LOST_PATTERN, str(error))
        ):
            raise ConnectionError(f"{LOST_PROCESS} ({str(error).splitlines()[0]})") from error
        raise


def launch(fabric: L.Fabric) -> None:
    """Launch the processes of a re-attack: none outlives the others, or waits for a lost one."""
    wait_long(fabric.strategy)
    _ending.clear()
    # Lightning's observer kills this process without a message
    fabric_script._launch_process_observer = _observe  # type: ignore[assignment]
    fabric.launch()
    _follow_parent(fabric.strategy, fabric.local_rank)


def _follow_parent(strategy: object, local_rank: int) -> None:
    """End this process with the one that started it, if Lightning did."""
    environment = getattr(strategy, "cluster_environment", None)
    if local_rank > 0 and isinstance(environment, LightningEnvironment):
        threading.Thread(target=_end_with_parent, args=(os.getppid(),), daemon=True).start()


def _observe(children: list[subprocess.Popen]) -> None:
    _children[:] = children
    threading.Thread(target=_end_with_children, daemon=True).start()


def _end_with_children() -> None:
    """End this process if it has not noticed that a child failed: a GPU would wait for ever."""
    while not any(child.poll() for child in _children):
        time.sleep(POLL_SECONDS)
    if not _ending.wait(GRACE_SECONDS):
        for child in _children:
            child.kill()
        complain(f"error: {LOST_PROCESS}")
        os._exit(1)


def _end_with_parent(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(POLL_SECONDS)
    os._exit(1)
