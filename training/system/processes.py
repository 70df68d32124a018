"""Which process of a run this is: the first one writes, prints and reports."""

import os
from typing import NamedTuple

from lightning_utilities.core.rank_zero import rank_zero_only


class Launcher(NamedTuple):
    """The environment variables of a launcher of processes.

    Args:
        ranks: those that hold a process's number, one or two.
        size: that of the number of processes.
        others: those by which Lightning recognises it, too.
    """

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
    the environment, where Lightning would find them; a line says so where that matters."""
    is_launched = False
    for launcher in LAUNCHERS:
        ranks = {name: os.environ[name] for name in launcher.ranks if name in os.environ}
        has_rank = all(rank.isdecimal() and int(rank) < processes for rank in ranks.values())
        if ranks and has_rank and os.environ.get(launcher.size) == str(processes):
            is_launched = True
            continue
        for name in (*launcher.ranks, launcher.size, *launcher.others):
            os.environ.pop(name, None)
        # the first of a single process is what the run has anyway
        if ranks and (processes > 1 or list(ranks.values())[-1] != "0"):
            _report_ignored(launcher, ranks, processes)
    if not is_launched:
        # Lightning may have read the environment before
        rank_zero_only.rank = 0  # type: ignore[attr-defined]
    return is_launched


def _report_ignored(launcher: Launcher, ranks: dict[str, str], processes: int) -> None:
    variables = " ".join(f"{name}={rank}" for name, rank in ranks.items())
    count = "1 process" if processes == 1 else f"{processes} processes"
    print(
        f"note: {variables} in the environment is ignored: this run has {count}, and "
        f"{launcher.size} does not say so. trainer.devices=N, times trainer.num_nodes, is how many "
        "share a run."
    )


def is_first() -> bool:
    """Return whether this is the first process of its run.

    Lightning knows it; until it has been imported, which takes seconds, the environment does."""
    rank = getattr(rank_zero_only, "rank", None)
    if rank is None:
        rank = next((os.environ[name] for name in RANK_VARIABLES if name in os.environ), 0)
    return int(rank) == 0


def print_once(text: str) -> None:
    """Print in the first process only."""
    if is_first():
        print(text)
