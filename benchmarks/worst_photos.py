"""How often a run's classifier is right on the worst of several photos of each image.

    python benchmarks/worst_photos.py runs/moire_at/seed0

The worst photo is that of several random ones, or what gradient steps over all that varies in the
scene find: each without noise, and with the Moiré Attack's at 4/255. Writes and prints
results/worst_photos.csv.
"""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

import pandas as pd

from benchmarks import measure
from moireaug import evaluation
from moireaug.evaluation import Cell, SuiteConfig, Table
from moireaug.evaluation.attackers import MoireAttacker
from moireaug.evaluation.suites.ensembles import movable_parts
from moireaug.scene.parts import PARTS
from training.attack.protocol import protocol_of
from training.data.load import load
from training.runs import trained

FULL_SETTINGS: dict[str, Any] = {"n": 160, "n_scene": 96, "steps": 20, "draws": (1, 10, 50)}
QUICK_SETTINGS: dict[str, Any] = {"n": 2, "n_scene": 1, "steps": 1, "draws": (1, 2)}
EPS = 4 / 255
NO_EPS = 1e-9  # of a photo without noise


def random_photos(config: SuiteConfig, draws: tuple[int, ...]) -> Table:
    """Return the suite of the worst of so many random photos."""
    cells = []
    for n in draws:
        for name, eps in (("no noise", NO_EPS), ("4/255", EPS)):
            attacker = MoireAttacker(
                eps=eps,
                steps=1 if eps == NO_EPS else config.steps,
                draws=n,
                variant=f"worst_of_{n}",
            )
            cells.append(Cell(f"worst of {n}", name, (attacker,)))
    return Table("random_photos", tuple(cells))


def searched_photos(config: SuiteConfig) -> Table:
    """Return the suite of gradient steps over all parts of the scene, with noise and without."""
    parts = movable_parts(config.scene, tuple(PARTS))
    cells = []
    for name, optimise in (("no noise", parts), ("4/255", ("noise", *parts))):
        attacker = MoireAttacker(
            eps=EPS, steps=config.steps, optimise=optimise, variant=f"moves_{len(optimise)}_parts"
        )
        cells.append(Cell("gradient steps", name, (attacker,)))
    return Table("searched_photos", tuple(cells))


def main() -> None:
    parser = measure.arguments(__doc__)
    parser.add_argument("run", type=Path, help="folder of a run")
    args, sizes, _ = measure.begin(parser, FULL_SETTINGS, QUICK_SETTINGS)
    run = trained.read(args.run)
    suites = {
        partial(random_photos, draws=sizes["draws"]): sizes["n"],
        searched_photos: sizes["n_scene"],
    }
    tables = []
    for suite, n in suites.items():
        run.cfg.reattack.n = n
        protocol = protocol_of(run.cfg, load(run.cfg.data))
        batches = [protocol.batches[i] for i in range(len(protocol.batches))]
        frame = evaluation.evaluate(
            run.model(), batches, suite, protocol.scene, steps=sizes["steps"]
        )
        tables.append(evaluation.rates(frame))
    columns = ["row", "column", "n", "accuracy", "accuracy_low", "accuracy_high"]
    measure.publish(pd.concat(tables)[columns], measure.results(args) / "worst_photos.csv")


if __name__ == "__main__":
    main()
