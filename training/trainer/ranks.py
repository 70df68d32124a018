"""The processes of a run: torchrun's agent starts them, and ends all with the first that fails."""

from __future__ import annotations

import inspect
import logging
import signal
import tempfile
import time
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch.distributed import DistError

from training.config.checks import check_devices
from training.config.schema import Trainer
from training.runs.layout import BEST, LAST
from training.system import machine
from training.system.files import read_checkpoint
from training.system.messages import (
    Terminated,
    has_lost_worker,
    is_expected,
    lacks_shared_memory,
    prepare_output,
    print_traceback,
    sentence,
    status_of,
)
from training.system.processes import join_launch

if TYPE_CHECKING:
    import lightning as L
    from lightning import Fabric

    from training.trainer.module import RecordedModule

LOST_PROCESS = (
    "another process of this run was lost: it was killed, ran out of memory, or failed with the "
    "error above. What is complete is kept, and the same command resumes from there."
)
GRACE_SECONDS = 5  # for a process to clean up; for the agent to see a lost one before the others


class RankError(ValueError):
    """An error of one of the processes, as a sentence."""


def run_job(settings: Trainer, job: Callable[..., Any], *args: Any) -> None:
    """Run `job(*args)` in as many processes of this machine as the trainer asks for: here, if that
    is one, or if a launcher such as torchrun or Slurm started the processes, see `join_launch`.

    Raises:
        ConnectionError, RankError: a process was lost, or has failed.
        KeyboardInterrupt: Ctrl-C or SIGTERM.
        ValueError: more devices than there are.
    """
    check_devices(settings)
    count = device_count(settings)
    is_launched = join_launch(count * settings.num_nodes)
    if is_launched or settings.num_nodes > 1 or count == 1:
        job(*args)
    else:
        _launch(count, job, *args)


def device_count(settings: Trainer) -> int:
    """Return the number of devices of this machine that the trainer asks for; Lightning would read
    a launcher's variables."""
    devices = settings.devices
    if devices in ("auto", -1):
        return torch.cuda.device_count() if machine.on_gpu(settings.accelerator) else 1
    return devices if isinstance(devices, int) else len(devices)


def _launch(count: int, job: Callable[..., Any], *args: Any) -> None:
    from torch.distributed.elastic.multiprocessing import DefaultLogsSpecs, SignalException
    from torch.distributed.elastic.multiprocessing.errors import ChildFailedError
    from torch.distributed.launcher.api import LaunchConfig, elastic_launch

    for name in ("torch.distributed.elastic", "torch.multiprocessing"):
        logger = logging.getLogger(name)  # a lost process gets a sentence instead
        logger.addHandler(logging.NullHandler())
        logger.propagate = False
    with tempfile.TemporaryDirectory(prefix="ranks-") as folder:
        # PyTorch waits longer for lost processes before 2.12, which takes no such time
        parameters = inspect.signature(LaunchConfig).parameters
        grace: Any = {"shutdown_timeout": GRACE_SECONDS} if "shutdown_timeout" in parameters else {}
        config = LaunchConfig(
            min_nodes=1,
            max_nodes=1,
            nproc_per_node=count,
            max_restarts=0,
            run_id=uuid.uuid4().hex,
            rdzv_backend="c10d",
            rdzv_endpoint="127.0.0.1:0",
            local_addr="127.0.0.1",
            logs_specs=DefaultLogsSpecs(folder),
            **grace,
        )
        try:
            elastic_launch(config, _run_rank)(count, job, *args)
        except SignalException as error:
            terminated = error.sigval == signal.SIGTERM
            raise (Terminated if terminated else KeyboardInterrupt) from None
        except ChildFailedError as error:
            _, failure = error.get_first_failure()
            if isinstance(failure.message, str):  # torch's own: it was killed
                raise ConnectionError(LOST_PROCESS) from None
            kind, _, text = failure.message["message"].partition(": ")
            if kind == RankError.__name__:
                print_traceback(failure.message["extraInfo"]["py_callstack"])
                raise RankError(text) from None
            raise


def _run_rank(count: int, job: Callable[..., Any], *args: Any) -> None:
    """Run the job in this process, one of those that the agent started."""
    prepare_output()
    torch.set_num_threads(max(1, torch.get_num_threads() // count))
    try:
        job(*args)
    except KeyboardInterrupt as interruption:
        raise SystemExit(status_of(interruption)) from None  # else success, to torch
    except Exception as error:
        if isinstance(error, ConnectionError):
            time.sleep(GRACE_SECONDS)
        if is_expected(error):
            raise RankError(sentence(error)) from error
        raise


def fit(
    trainer: L.Trainer, module: RecordedModule, batches: L.LightningDataModule, folder: Path
) -> tuple[dict[str, Any], float]:
    """Train, and load the best weights into the module.

    Args:
        batches: with the attribute `first_epoch`; above 0, training resumes from last.ckpt.
        folder: folder of the run, in which last.ckpt and best.ckpt are kept.

    Returns:
        The best checkpoint, and the seconds of all epochs, those before a resumption included.

    Raises:
        ConnectionError: another process was lost.
        KeyboardInterrupt: Ctrl-C or SIGTERM.
    """
    first_epoch: int = batches.first_epoch  # type: ignore[attr-defined]
    start_time = time.perf_counter()
    try:
        trainer.fit(module, batches, ckpt_path=folder / LAST if first_epoch else None)
    except SystemExit as end:  # what Lightning makes of both
        if isinstance(end.__context__, Terminated):
            raise Terminated from None
        raise KeyboardInterrupt from None
    except RuntimeError as error:
        if lacks_shared_memory(error):  # of workers, whose message names them as lost
            raise
        is_lost = isinstance(error, DistError) or "gloo" in str(error)  # a plain RuntimeError's
        if is_lost or has_lost_worker(error):
            raise ConnectionError(f"{LOST_PROCESS} ({str(error).splitlines()[0]})") from error
        raise
    seconds = time.perf_counter() - start_time
    for epoch in module.history[:first_epoch]:
        seconds += epoch["seconds"] + epoch["validation_seconds"]
    best = read_checkpoint(folder / BEST)
    module.load_state_dict(best["state_dict"])
    return best, seconds


def fabric_of(settings: Trainer) -> Fabric:
    """Return Lightning's Fabric of the processes that share the work, set up as in training."""
    from lightning import Fabric  # takes seconds to import

    fabric = Fabric(
        accelerator=machine.accelerator(settings.accelerator),
        devices=settings.devices,
        num_nodes=settings.num_nodes,
        strategy=settings.strategy,
    )
    fabric.launch()
    return fabric
