"""What a forked process must not do: OpenMP's threads do not survive a fork, and whatever waits for
them hangs."""

import os

import torch

IMPORTING_PROCESS_ID = os.getpid()  # that imported this module, and may use its threads
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=lambda: torch.set_num_threads(1))


def is_forked() -> bool:
    """Return whether this process was forked from the one that imported this module."""
    return os.getpid() != IMPORTING_PROCESS_ID
