"""Which process of a run this is: the first one writes, prints and reports."""

from __future__ import annotations

import os
from typing import NamedTuple

from lightning_utilities.core.rank_zero import rank_zero_only


class Launcher(NamedTuple):
    """The variables that a launcher of processes sets: each process's number, under one or two
    names, how many there are, and what else makes Lightning take them for its own."""

    ranks: tuple[str, ...]
    size: str
    others: tuple[str, ...]


LAUNCHERS = (
    Launcher(("RANK", "LOCAL_RANK"), "WORLD_SIZE", ("TORCHELASTIC_RUN_ID",)),
    Launcher(("SLURM_PROCID",), "SLURM_NTASKS", ("SLURM_LOCALID", "SLURM_NTASKS_PER_NODE")),
    Launcher(("JSM_NAMESPACE_RANK",), "JSM_NAMESPACE_SIZE", ("JSM_NAMESPACE_LOCAL_RANK",)),
)
# in the order in which Lightning looks for the process's number
RANK_VARIABLES = tuple(name for launcher in LAUNCHERS for name in launcher.ranks)


def join_launch(processes: int) -> bool:
    """Return whether a launcher, such as torchrun or Slurm, has started this process for a run of
    so many.

    Its variables belong to the run if it started as many processes as the run has. Those of any
    other, such as a pod's or the job's that a shell was opened in, are ignored and taken out of
    the environment, where Lightning would find them; a line says so where that matters.
    """
    joined = False
    for launcher in LAUNCHERS:
        found = [name for name in launcher.ranks if name in os.environ]
        if found and _is_of(launcher, found, processes):
            joined = True
            continue
        given = " ".join(f"{name}={os.environ[name]}" for name in found)
        for name in (*launcher.ranks, launcher.size, *launcher.others):
            os.environ.pop(name, None)
        if found and (processes > 1 or not given.endswith("=0")):
            are = "process" if processes == 1 else "processes"
            print(
                f"note: {given} in the environment is ignored: this run has {processes} {are}, and "
                f"{launcher.size} does not say so. trainer.devices=N, times trainer.num_nodes, is "
                "how many share a run."
            )
    if not joined:
        # Lightning may have read the environment before
        rank_zero_only.rank = 0  # type: ignore[attr-defined]
    return joined


def _is_of(launcher: Launcher, found: list[str], processes: int) -> bool:
    """Return whether a launcher's variables describe a process of a run of so many."""
    numbers = [os.environ[name] for name in found]
    if not all(number.isdecimal() and int(number) < processes for number in numbers):
        return False
    return os.environ.get(launcher.size) == str(processes)


def is_first() -> bool:
    """Return whether this is the first process of its run.

    Lightning knows it; until it has been imported, which takes seconds, the environment does.
    """
    rank = getattr(rank_zero_only, "rank", None)
    if rank is None:
        rank = next((os.environ[name] for name in RANK_VARIABLES if name in os.environ), 0)
    return int(rank) == 0


def say(text: str) -> None:
    """Print in the first process only."""
    if is_first():
        print(text)
