"""Timing, metadata and tables that every benchmark shares."""

from __future__ import annotations

import argparse
import datetime
import inspect
import json
import os
import platform
import random
import time
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import torch

RESULTS = Path(__file__).resolve().parent / "results"
LIBRARIES = ("torch", "torchvision", "kornia", "albumentations", "numpy", "numba")
MIN_RUNS = 3  # runs that even a slow candidate gets


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
) -> dict[str, Timing]:
    """Time candidates in turns, in another order each round, so that a drifting machine and a cache
    emptied by a large neighbour hit all alike.

    Args:
        repeats: rounds, in each of which every candidate runs once.
        warmup: calls of each that are not counted: they fill caches and make plans.
        budget: seconds after which a slow candidate sits out, once it has run `MIN_RUNS` times.
    """
    for function in candidates.values():
        for _ in range(warmup):
            function()
    spent: dict[str, list[float]] = {name: [] for name in candidates}
    order = random.Random(0)
    for _ in range(repeats):
        for name in order.sample(list(candidates), len(candidates)):
            if len(spent[name]) < MIN_RUNS or sum(spent[name]) < budget:
                spent[name].append(_clock(candidates[name]))
    return {name: Timing.of(seconds) for name, seconds in spent.items()}


def _clock(function: Callable[[], Any]) -> float:
    _finish()
    began = time.perf_counter()
    function()
    _finish()
    return time.perf_counter() - began


def _finish() -> None:
    if torch.cuda.is_available():  # a GPU's kernels run on after their call has returned
        torch.cuda.synchronize()


def frontier(points: Sequence[tuple[float, float]]) -> list[int]:
    """Return the Pareto frontier of (cost, error) points: indices, cheapest first, of those that no
    cheaper one matches."""
    kept: list[int] = []
    for i in sorted(range(len(points)), key=lambda i: points[i]):
        if not kept or points[i][1] < points[kept[-1]][1]:
            kept.append(i)
    return kept


def metadata(device: str = "cpu") -> dict[str, Any]:
    """Return the machine, its load and the libraries. Call it before anything is timed.

    Args:
        device: that the script runs on; a GPU that is there but unused is not named.
    """
    return {
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "device": name_of(device),
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "threads": torch.get_num_threads(),
        "load_average_at_start": list(os.getloadavg()) if hasattr(os, "getloadavg") else None,
        "python": platform.python_version(),
        **{name: version(name) for name in LIBRARIES},
    }


def name_of(device: str) -> str:
    """Return the name of a GPU, or "cpu"."""
    return "cpu" if device == "cpu" else torch.cuda.get_device_name(device)


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    return next(
        (line.split(":")[1].strip() for line in lines if line.startswith("model name")),
        platform.machine(),
    )


def machine_lines(facts: Mapping[str, Any]) -> str:
    """Return the metadata in two lines."""
    libraries = ", ".join(f"{name} {facts[name]}" for name in ("python", *LIBRARIES))
    load = facts["load_average_at_start"]
    cores = f"{facts['cores']} cores, {facts['threads']} threads"
    machine = f"{facts['cpu']}, {cores}, device {facts['device']}"
    return (
        f"{machine}, load {load[0]:.2f} at start\n{libraries}"
        if load
        else f"{machine}\n{libraries}"
    )


def table(columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Return plain text with aligned columns: those with any value but words and None to the right,
    words to the left."""
    aligned = []
    for i, name in enumerate(columns):
        values = [row[i] for row in rows]
        cells = [name, *map(show, values)]
        width = max(map(len, cells))
        cells.insert(1, "-" * width)
        to_the_right = any(not isinstance(v, str) and v is not None for v in values)
        place = str.rjust if to_the_right else str.ljust
        aligned.append([place(cell, width) for cell in cells])
    return "\n".join("  ".join(line).rstrip() for line in zip(*aligned, strict=True))


def show(value: Any) -> str:
    """Return a value as text: floats below 1000 with three digits, nothing for None."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
    return "" if value is None else str(value)


def in_ms(seconds: Mapping[str, float]) -> tuple[float, str]:
    """Return median and quartiles in ms of a `Timing`'s dict, for a table."""
    return 1e3 * seconds["median"], f"{show(1e3 * seconds['low'])} to {show(1e3 * seconds['high'])}"


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=1) + "\n")


def publish(table: pd.DataFrame, path: Path) -> None:
    """Write a table as CSV, and print it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    table.to_csv(path, index=False, float_format="%.4g")
    print(table.to_string(index=False, float_format="{:.3f}".format))


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


def results(args: argparse.Namespace) -> Path:
    """Return the folder that a script writes into."""
    return args.out or (RESULTS / "quick" if args.quick else RESULTS)
