"""What each suite of `training/reattack.py` costs in time.

    python benchmarks/suites.py runs/moire_at/seed0

Attacks a run of training/fit.py by every suite in 20 steps, without the report's checks, and
reuses nothing. Writes and prints results/suites.csv: the CPU seconds that n images took, whatever
else the machine did, and the CPU minutes of 480 images at that rate. Few images make small batches,
which cost more each: an upper estimate.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

import pandas as pd

from benchmarks import measure
from training.attack.protocol import SuiteAttack
from training.attack.subject import subject_of_run
from training.attack.suite_config import suite_config
from training.config.checks import merge_run_settings
from training.config.schema import Reattack, ReattackConfig
from training.runs import trained
from training.suites import SUITES
from training.trainer.ranks import fabric_of

FULL_SETTINGS: dict[str, Any] = {"n": 16, "steps": 20, "suites": tuple(SUITES)}
QUICK_SETTINGS: dict[str, Any] = {"n": 1, "steps": 1, "suites": ("unseen", "transfer")}
REPORTED_IMAGES = 480  # images that the minutes are of


def cpu_seconds(run: trained.TrainedRun, suite: str, n: int, steps: int) -> float:
    """Return the CPU seconds that a suite takes on n test images of a run."""
    folder = str(run.folder)
    given = ReattackConfig(run=folder, suite=suite, reattack=Reattack(n=n, steps=steps))
    names = [f"run={folder}", f"suite={suite}", f"reattack.n={n}", f"reattack.steps={steps}"]
    if suite == "transfer":  # to itself: a model of the same size
        given.targets = {"itself": folder}
        names.append("targets=itself")
    if suite == "demoireing":
        given.networks = {"amnet": "screen"}
        names.append("networks=amnet")
    cfg = merge_run_settings(run.cfg, given, names)
    with tempfile.TemporaryDirectory() as records:
        subject = subject_of_run(cfg, run, run.folder)._replace(records=Path(records))
        config = suite_config(cfg, subject, fabric_of(cfg.trainer))
        attack = SuiteAttack(
            subject.model, suite, subject.protocol, subject.records, config, check=False
        )
        began = time.process_time()
        attack.run(suite)
        return time.process_time() - began


def main() -> None:
    parser = measure.arguments(__doc__)
    parser.add_argument("run", type=Path, help="folder of a run")
    args, sizes, _ = measure.begin(parser, FULL_SETTINGS, QUICK_SETTINGS)
    try:
        run = trained.read(args.run)
    except ValueError as error:
        parser.error(str(error))
    cpu_seconds(run, "success", 1, 1)  # kernels and layers start
    rows = []
    for suite in sizes["suites"]:
        took = cpu_seconds(run, suite, sizes["n"], sizes["steps"])
        rows.append(
            {
                "suite": suite,
                "n": sizes["n"],
                "cpu_seconds": took,
                "cpu_minutes": took * REPORTED_IMAGES / sizes["n"] / 60,
            }
        )
    measure.publish(pd.DataFrame(rows), measure.results(args) / "suites.csv")


if __name__ == "__main__":
    main()
