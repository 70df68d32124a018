"""What commands print: errors on lines of their own, each a sentence."""

import codecs
import errno
import os
import re
import sys
import traceback
import unicodedata
from multiprocessing import synchronize
from typing import Any, TextIO

# before `hydra_commands` sets that variable, for its own sake
SHOWS_TRACEBACKS = os.environ.get("HYDRA_FULL_ERROR") == "1"
EXPECTED_ERRORS = (ValueError, TypeError, FloatingPointError, OSError)
_NO_SHARED_MEMORY = r"unable to \w+ shared memory|out of shared memory"
SHARED_MEMORY_ADVICE = (
    "the workers ran out of shared memory: /dev/shm is full, or small, as in a container (df -h "
    "/dev/shm shows it). Make it larger (docker run --shm-size=2g, or --ipc=host), or have fewer "
    "workers: data.workers=0, or in training/synthesise.py workers=0, needs none. Everything "
    "complete is kept, and the same command continues."
)
LOST_WORKER = (
    "a worker process was lost: it was killed, or ran out of memory. What is complete is kept: "
    "give the same command again; with fewer workers it needs less memory."
)
LIGHTNING_ERROR = "MisconfigurationException"  # by its name, as Lightning takes seconds to import
LEGIBLE = "legible"
# those that raise, and stderr's own, which writes "\\u2212" for a minus sign
REPLACED_HANDLERS = ("strict", "surrogateescape", "backslashreplace")
LOOKALIKES = {
    **dict.fromkeys("\u2010\u2011\u2012–—−", "-"),
    **dict.fromkeys("‘’", "'"),
    **dict.fromkeys("“”", '"'),
    **dict(zip("×✗✓·●†→≤≥δεμσ", "xxv.*+><>deus", strict=True)),
}


class Terminated(KeyboardInterrupt):  # as KeyboardInterrupt
    """SIGTERM, which ends a command as Ctrl-C does, but with the status 143."""


def terminate(number: int, frame: Any) -> None:
    """Raise `Terminated`: a handler of SIGTERM."""
    raise Terminated


def status_of(interruption: KeyboardInterrupt) -> int:
    """Return the exit status of an interrupted command, 128 and the signal's number."""
    return 143 if isinstance(interruption, Terminated) else 130


class LineStream:
    """Wraps an output stream and knows whether its last line is complete: a progress bar's is
    not."""

    def __init__(self, stream: TextIO) -> None:
        self._stream, self.has_open_line = stream, False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        if text:
            self.has_open_line = not text.endswith("\n")
        return self._stream.write(text)


def prepare_output() -> None:
    """Have standard output and error print legibly the characters that their encoding lacks, so
    that no command ends in a UnicodeEncodeError after its work is done; the handlers "replace" and
    "ignore", chosen with PYTHONIOENCODING, stay. Where there are no streams, as in a daemon or a
    program without a console, what is printed goes nowhere."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115  # for good
        stream: Any = getattr(sys, name)
        if getattr(stream, "errors", None) in REPLACED_HANDLERS and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors=LEGIBLE)


def print_error(text: str) -> None:
    """Print to standard error, starting on a new line."""
    for stream in (sys.stdout, sys.stderr):
        if getattr(stream, "has_open_line", False):
            print(file=stream, flush=True)
    print(text, file=sys.stderr, flush=True)


def print_traceback(text: str | None = None) -> None:
    """Print the traceback of the error that is handled, where HYDRA_FULL_ERROR=1 asks for it: a bug
    may raise a ValueError, too.

    Args:
        text: that of another process; None: of this one.
    """
    if SHOWS_TRACEBACKS:
        print_error(text or traceback.format_exc())


def count_text(n: int, noun: str) -> str:
    """Return a number with its noun, in the singular for one."""
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def is_expected(error: Exception) -> bool:
    """Return whether an error is a user's or the machine's, for which a sentence is enough."""
    if isinstance(error, EXPECTED_ERRORS) or type(error).__name__ == LIGHTNING_ERROR:
        return True
    return lacks_shared_memory(error) or has_lost_worker(error)


def lacks_shared_memory(error: BaseException | None) -> bool:
    """Return whether the workers of a DataLoader found too little shared memory: the error, or what
    it was raised from, says so, or a semaphore, which lies there too, could not be made."""
    while error is not None:
        if isinstance(error, OSError):
            frames = traceback.extract_tb(error.__traceback__)
            if error.errno == errno.ENOSPC:  # a full disk has the same number
                return any(frame.filename == synchronize.__file__ for frame in frames)
        elif isinstance(error, RuntimeError) and re.search(_NO_SHARED_MEMORY, str(error)):
            return True
        error = error.__cause__ or error.__context__
    return False


def has_lost_worker(error: Exception) -> bool:
    """Return whether a worker of a DataLoader has ended, as its loader says."""
    return isinstance(error, RuntimeError) and str(error).startswith("DataLoader worker (pid")


def sentence(error: Exception) -> str:
    """Return the message of an error, without the traceback that a DataLoader's worker adds."""
    if lacks_shared_memory(error):
        return SHARED_MEMORY_ADVICE
    if has_lost_worker(error):
        return LOST_WORKER
    if isinstance(error, OSError) and error.errno:  # the system's own words
        advice = "Everything complete is kept: fix this, and resume with the same command."
        return f"{error}. {advice}"
    # a traceback names the class by its module, unless it is Python's own
    raised = rf"\n(?:[\w.]+\.)?{type(error).__name__}: "
    return re.split(raised, str(error))[-1].strip() or type(error).__name__


def _legible(error: Any) -> tuple[str, int]:
    """Replace the next character that an encoding lacks, one for one, so that tables stay aligned:
    codecs' handler of errors."""
    plain = unicodedata.normalize("NFKD", error.object[error.start])[0]  # "é" is "e" and an accent
    return LOOKALIKES.get(plain, plain if plain.isascii() else "?"), error.start + 1


codecs.register_error(LEGIBLE, _legible)
