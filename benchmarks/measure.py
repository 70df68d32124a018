"""Timing, the machine, and tables: what every benchmark shares."""

from __future__ import annotations

import argparse
import datetime
import inspect
import json
import os
import random
import time
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
import pandas as pd
import torch

from training.system import machine

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks/results"
LIBRARIES = ("albumentations", "numba")  # beside those of `machine.environment`
MIN_RUNS = 3  # runs that even a slow candidate gets
Sizes = TypeVar("Sizes")


class Timing(NamedTuple):
    """Seconds of a call: median, quartiles and mean over `runs` runs."""

    median: float
    low: float
    high: float
    mean: float
    runs: int

    @staticmethod
    def of(seconds: Sequence[float]) -> Timing:
        low, median, high = np.percentile(seconds, [25, 50, 75]).tolist()
        return Timing(median, low, high, float(np.mean(seconds)), len(seconds))

    def __truediv__(self, n: float) -> Timing:  # type: ignore[override]
        """Return the same for one of n images."""
        return Timing(*(s / n for s in self[:4]), self.runs)


def timed(function: Callable[[], Any], repeats: int = 15, warmup: int = 1) -> Timing:
    """Time one function, after `warmup` calls that are not counted."""
    return timed_together({"it": function}, repeats, warmup)["it"]


def timed_together(
    candidates: Mapping[str, Callable[[], Any]],
    repeats: int = 15,
    warmup: int = 1,
    budget: float = float("inf"),
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, Timing]:
    """Time candidates in turns, in another order each round, so that a drifting machine and a cache
    emptied by a large neighbour hit all alike.

    Args:
        repeats: rounds, in each of which every candidate runs once.
        warmup: calls of each that are not counted: they fill caches and make plans.
        budget: seconds after which a slow candidate sits out, once it has run `MIN_RUNS` times.
        clock: in seconds; `time.process_time` is that of the cores alone, whatever else they do.
    """
    for function in candidates.values():
        for _ in range(warmup):
            function()
    spent: dict[str, list[float]] = {name: [] for name in candidates}
    order = random.Random(0)
    for _ in range(repeats):
        for name in order.sample(list(candidates), len(candidates)):
            if len(spent[name]) < MIN_RUNS or sum(spent[name]) < budget:
                spent[name].append(_seconds(candidates[name], clock))
    return {name: Timing.of(seconds) for name, seconds in spent.items()}


def _seconds(function: Callable[[], Any], clock: Callable[[], float]) -> float:
    _finish()
    began = clock()
    function()
    _finish()
    return clock() - began


def _finish() -> None:
    if torch.cuda.is_available():  # a GPU's kernels run on after their call has returned
        torch.cuda.synchronize()


def arguments(doc: str) -> argparse.ArgumentParser:
    """Return a parser of the options that every script takes."""
    parser = argparse.ArgumentParser(
        description=inspect.cleandoc(doc), formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="tiny sizes, a few seconds: only shows that it runs",
    )
    parser.add_argument(
        "--out",
        type=Path,
        help="folder of the results; without it they replace the published ones, or with --quick "
        "go into a folder beside them",
    )
    parser.add_argument("--threads", type=int, default=2)
    return parser


def begin(
    parser: argparse.ArgumentParser, full: Sizes, quick: Sizes
) -> tuple[argparse.Namespace, Sizes, dict[str, Any]]:
    """Read the command line, set the threads and print the machine, before anything is timed.

    Returns:
        the options, the sizes that they choose, and the facts of the machine, whose GPU is named
        where an option `--device` asks for it.
    """
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    facts = metadata(vars(args).get("device", "cpu"))
    print(machine_lines(facts), end="\n\n")
    return args, quick if args.quick else full, facts


def metadata(device: str = "cpu") -> dict[str, Any]:
    """Return the machine, its load and the libraries; of the device "cpu" without its GPU."""
    return {
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "cores": os.cpu_count(),
        "load_average_at_start": list(os.getloadavg()) if hasattr(os, "getloadavg") else None,
        **machine.environment(device),
        **{name: version(name) for name in LIBRARIES},
    }


def machine_lines(facts: Mapping[str, Any]) -> str:
    """Return the metadata in two lines."""
    line = f"{facts['cpu']}, {facts['cores']} cores, {facts['threads']} threads, "
    line += f"device {facts['device']}"
    if facts["load_average_at_start"]:
        line += f", load {facts['load_average_at_start'][0]:.2f} at start"
    names = ("python", "torch", "torchvision", "kornia", "numpy", *LIBRARIES)
    return f"{line}\n" + ", ".join(f"{name} {facts[name]}" for name in names)


def results(args: argparse.Namespace) -> Path:
    """Return the folder that a script writes into."""
    folder = args.out or (RESULTS / "quick" if args.quick else RESULTS)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def write_json(args: argparse.Namespace, name: str, **content: Any) -> None:
    (results(args) / f"{name}.json").write_text(json.dumps(content, indent=1) + "\n")


def publish(table: pd.DataFrame, path: Path) -> None:
    """Write a table as CSV, and print it."""
    table.to_csv(path, index=False, float_format="%.4g")
    print(text_of(table))


def text_of_rows(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows with names as text; their `seconds`, a `Timing`'s dict, are shown in ms."""
    table = pd.DataFrame(rows)
    if "seconds" in table:
        times = [in_ms(seconds) for seconds in table.pop("seconds")]
        table["ms"], table["quartiles"] = zip(*times, strict=True)
    return text_of(table)


def text_of(table: pd.DataFrame) -> str:
    cells = table.astype(object).where(table.notna(), "")
    return cells.to_string(index=False, float_format=show)


def show(value: float) -> str:
    """Return a number as text, with three digits below 1000."""
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def in_ms(seconds: Mapping[str, float]) -> tuple[float, str]:
    """Return median and quartiles in ms of a `Timing`'s dict, for a table."""
    return 1e3 * seconds["median"], f"{show(1e3 * seconds['low'])} to {show(1e3 * seconds['high'])}"
