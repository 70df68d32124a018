"""A machine's first call: kernels are compiled, and somebody waits."""

from __future__ import annotations

import functools
import logging

from moireaug.engine.cpu import ahead, compiling


def announce(message: str) -> None:
    """Tell the user that kernels are about to be compiled. Replace this function to say it
    elsewhere."""
    logging.getLogger("moireaug").warning(message)


@functools.lru_cache(maxsize=1)
def prepare() -> None:
    """Announce, on a machine's first call, that kernels are being compiled, and start on those that
    come later."""
    if not compiling.cold():
        return
    announce("moireaug compiles its CPU kernels, once on this machine; this takes up to a minute.")
    ahead.start(compiling.folder())


@functools.lru_cache(maxsize=1)
def prepare_back() -> None:
    """Announce, on a machine's first gradient in images, that its kernels are being compiled."""
    if compiling.cold("expose_back_kernels"):
        announce(
            "moireaug compiles its CPU kernels of the gradient in images, once on this machine; "
            "this takes up to a minute."
        )
