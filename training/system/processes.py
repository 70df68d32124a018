"""Which process of a run this is: the first one writes, prints and reports."""

from __future__ import annotations

import os

from lightning_utilities.core.rank_zero import rank_zero_only

# of the variables that launchers set, the first that is there says the process's number
RANK_VARIABLES = ("RANK", "LOCAL_RANK", "SLURM_PROCID", "JSM_NAMESPACE_RANK")


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
