"""Other processes that run this or an older checkout of the project, so that they take turns in one
run."""

from __future__ import annotations

import argparse
import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from moireaug import Scene

HERE = Path(__file__).resolve().parents[1]


class Checkout:
    """A process that runs `worker.py` on a checkout. Use it in a `with` block, which ends the
    process.

    Args:
        root: of the checkout.
        threads: of torch.
        engine: whether the engine may run; False forces the reference. A checkout from before the
            engine ignores it.

    Raises:
        RuntimeError: the process has ended; its error is on stderr.
    """

    def __init__(self, root: Path = HERE, threads: int = 2, engine: bool = True) -> None:
        environment = dict(os.environ)
        environment.pop("MOIREAUG_ENGINE", None)
        if not engine:
            environment["MOIREAUG_ENGINE"] = "off"
        self.root = root.resolve()
        worker = [sys.executable, str(HERE / "benchmarks/worker.py"), str(self.root), str(threads)]
        self.process = subprocess.Popen(
            worker, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment
        )
        if not Path(self.ask("where")).is_relative_to(self.root):
            self.__exit__()
            raise RuntimeError(f"{self.root} has no moireaug of its own: another one was imported.")

    def ask(self, name: str, **arguments: Any) -> Any:
        """Call a function of `worker.py` by its name, and return what it returns."""
        try:
            pickle.dump((name, arguments), self.process.stdin)
            self.process.stdin.flush()
            return pickle.load(self.process.stdout)
        except (EOFError, BrokenPipeError) as error:
            raise RuntimeError(
                f"{name!r} failed in a process on {self.root}; its error is above."
            ) from error

    def call(self, key: str, what: str) -> Callable[[], None]:
        """Return a function that runs there what was kept under `key`, and waits for it."""
        return lambda: self.ask("run", key=key, what=what)

    def __enter__(self) -> Checkout:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.stdin.close()
        self.process.stdout.close()
        self.process.wait()


def plain(scene: Scene) -> dict[str, Any]:
    """Return the fields in which a scene differs from the default one; an older checkout may not
    know them all."""
    return {"tolerance": scene.tolerance, **scene.changed_fields()}


def add_before(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--before",
        type=_checkout,
        metavar="DIR",
        help="an older checkout to measure in turns, as made by `git worktree`",
    )


def _checkout(folder: str) -> Path:
    if not (Path(folder) / "moireaug/__init__.py").is_file():
        raise argparse.ArgumentTypeError(
            f"{folder} has no moireaug/__init__.py: it must be a checkout's root."
        )
    return Path(folder).resolve()


def commit(root: Path | None) -> str | None:
    """Return a checkout's commit, or None if git knows none."""
    if root is None or not (root / ".git").exists():
        return None
    told = subprocess.run(
        ["git", "-C", str(root), "rev-parse", "--short", "HEAD"], capture_output=True, text=True
    )
    return told.stdout.strip() or None
