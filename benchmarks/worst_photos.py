"""How often a run's classifier is right on the worst of several random photos of each image.

    python benchmarks/worst_photos.py runs/moire_at/seed0

The worst is the one that fools the model most; it is shown without noise, and with that of the
Moiré Attack at 4/255. Writes and prints results/worst_photos.csv.
"""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

from benchmarks import measure
from moireaug import evaluation
from moireaug.evaluation import Cell, SuiteConfig, Table
from moireaug.evaluation.attackers import MoireAttacker
from training.attack.protocol import protocol_of
from training.data.load import load
from training.runs import trained

FULL_SETTINGS: dict[str, Any] = {"n": 160, "steps": 20, "draws": (1, 10)}
QUICK_SETTINGS: dict[str, Any] = {"n": 2, "steps": 1, "draws": (1, 2)}
EPS = 4 / 255
NO_EPS = 1e-9  # of a photo without noise, as good as


def worst_photos(config: SuiteConfig, draws: tuple[int, ...]) -> Table:
    """Return the suite of the worst of so many photos."""
    cells = []
    for n in draws:
        for name, eps, steps in (("no noise", NO_EPS, 1), ("4/255", EPS, config.steps)):
            attacker = MoireAttacker(eps=eps, steps=steps, draws=n, variant=f"worst_of_{n}")
            cells.append(Cell(f"worst of {n}", name, (attacker,)))
    return Table("worst_photos", tuple(cells))


def main() -> None:
    parser = measure.arguments(__doc__)
    parser.add_argument("run", type=Path, help="folder of a run")
    args, sizes, _ = measure.begin(parser, FULL_SETTINGS, QUICK_SETTINGS)
    run = trained.read(args.run)
    run.cfg.reattack.n = sizes["n"]
    protocol = protocol_of(run.cfg, load(run.cfg.data))
    batches = [protocol.batches[i] for i in range(len(protocol.batches))]
    suite = partial(worst_photos, draws=sizes["draws"])
    frame = evaluation.evaluate(
        run.model(), batches, suite, protocol.scene, steps=sizes["steps"], progress=False
    )
    columns = ["row", "column", "n", "accuracy", "accuracy_low", "accuracy_high"]
    measure.publish(evaluation.rates(frame)[columns], measure.results(args) / "worst_photos.csv")


if __name__ == "__main__":
    main()
