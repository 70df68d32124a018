"""The files of a run in its folder, and the folders in it and beside it."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from moireaug.common.files import write_text
from training.system.files import read_json

SETTINGS = "config.yaml"
BEST, LAST = "best.ckpt", "last.ckpt"  # weights that did best on validation; those to resume from
COST = "train.json"  # of the training, until METRICS holds it
METRICS = "metrics.json"  # written last: the run is finished
REPORT = "report.html"
NETWORK = "weights.pt"  # of a run that trained a demoiréing network
RECORDS = "records"  # finished pieces of attacks
REATTACKS = "reattack"  # results of other attacks
FRONTIER = "frontier"  # the table of a folder of runs


def run_folder(runs: Path, recipe: str, seed: int) -> Path:
    """Return the folder of a run in that of its group."""
    return runs / recipe / f"seed{seed}"


def finished_runs(group: Path) -> list[Path]:
    """Return the folders of the finished runs of a group, without those that were set aside."""
    folders = [file.parent for file in sorted(group.glob(f"*/seed*/{METRICS}"))]
    return [folder for folder in folders if folder.name.removeprefix("seed").isdecimal()]


def write_metrics(folder: Path, values: Mapping[str, Any]) -> None:
    """Write the metrics of a finished run, which hold the cost of its training, too."""
    write_text(folder / METRICS, json.dumps(values, indent=1))
    (folder / COST).unlink(missing_ok=True)


def read_metrics(folder: Path) -> dict[str, Any] | None:
    """Read the metrics of a finished run; None where there are none."""
    return read_json(folder / METRICS)


def training_cost(folder: Path) -> Any:
    """Return the cost of a run's training, as it was written; None before its end."""
    return read_json(folder / COST) or (read_metrics(folder) or {}).get("train")
