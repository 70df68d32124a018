"""What the accuracy of an evaluation costs: robust accuracy against the steps, restarts and seconds
of each attacker.

    python benchmarks/attack_budget.py runs/baseline/seed0 runs/moire_at/seed0

Attacks runs of training/fit.py on the raw reading of their own scene, at one eps, with every
attacker at every budget, all on the same images and shots. Writes and prints
results/attack_budget.csv, and prints for each run the cheapest budget whose accuracy is within a
point of the lowest that any attacker reached.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

import pandas as pd
import torch
from torch import nn

from benchmarks import measure
from moireaug.evaluation import Cell, Table, images_frame, rates
from moireaug.evaluation.attackers import Attacker, MoireAttacker, PhotoUnknownAttacker
from moireaug.evaluation.autoattack import APGDTAttacker, SquareAttacker
from moireaug.evaluation.batches import Batches
from moireaug.evaluation.records import EvalSetup, Records
from moireaug.evaluation.runner import Runner, jobs_of
from moireaug.scenes import Scene
from training.attack.protocol import protocol_of
from training.data.load import load
from training.runs import trained

STEPS = (1, 2, 5, 10, 20, 50)
FULL_SETTINGS: dict[str, Any] = {"steps": STEPS, "n": 96}
QUICK_SETTINGS: dict[str, Any] = {"steps": (1, 2), "n": 4}
EPS = 4 / 255
QUERIES = 20  # of Square, for each step of the others
MAX_ACCURACY_GAP = 0.01  # a point


def attackers(steps: int) -> dict[str, Attacker]:
    """Return every attacker at one budget."""
    return {
        "MA": MoireAttacker(eps=EPS, steps=steps),
        "APGD-CE": MoireAttacker(eps=EPS, steps=steps, variant="apgd_ce", rule="apgd"),
        "APGD, margin, 2 restarts": MoireAttacker(
            eps=EPS, steps=steps, variant="apgd_margin", rule="apgd", loss="margin", restarts=2
        ),
        "APGD-T": APGDTAttacker(eps=EPS, steps=steps),
        "Square": SquareAttacker(eps=EPS, steps=QUERIES * steps),
        "MA, photo unknown": PhotoUnknownAttacker(eps=EPS, steps=steps),
    }


def measure_run(
    model: nn.Module, batches: Batches, scene: Scene, settings: dict[str, Any]
) -> list[dict[str, Any]]:
    """Return accuracy and seconds per image of every attacker at every budget."""
    found = []
    # the first attack of a process pays for loading and caches
    warm = Table("warm-up", (Cell("MA", "1", (attackers(1)["MA"],)),))
    for _ in Runner(model, batches, EvalSetup(scene), Records()).run(jobs_of([warm]), [0]):
        pass
    for steps in settings["steps"]:
        cells = [Cell(name, str(steps), (attack,)) for name, attack in attackers(steps).items()]
        table = Table("budget", tuple(cells))
        runner = Runner(model, batches, EvalSetup(scene), Records())
        for _ in runner.run(jobs_of([table]), range(len(batches))):
            pass
        lines = rates(images_frame([table], runner, range(len(batches))))
        for line in lines.to_dict("records"):
            row = {"attacker": line["row"], "steps": steps}
            for name in ("accuracy", "accuracy_low", "accuracy_high", "n"):
                row[name] = line[name]
            row["seconds_per_image"] = line["seconds"] / line["n"]
            found.append(row)
    return found


def recommended(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the cheapest row that is within a point, or an image, of the lowest accuracy that any
    attacker reached."""
    least = min(row["accuracy"] for row in rows)
    slack = max(MAX_ACCURACY_GAP, 1 / rows[0]["n"])
    enough = [row for row in rows if row["accuracy"] <= least + slack + 1e-9]
    return min(enough, key=lambda row: row["seconds_per_image"])


def models_of(folders: list[str], n: int) -> dict[str, tuple[nn.Module, Batches, Scene]]:
    """Return, by their folders, the runs' models with their test images and scene."""
    found: dict[str, tuple[nn.Module, Batches, Scene]] = {}
    for folder in folders:
        run = trained.read(Path(folder))
        run.cfg.reattack.n = n
        protocol = protocol_of(run.cfg, load(run.cfg.data))
        found[folder] = (run.model(), protocol.batches, protocol.scene)
    return found


def quick_model(n: int) -> dict[str, tuple[nn.Module, Batches, Scene]]:
    """Return an untrained model, with the labels that it predicts."""
    torch.manual_seed(0)
    model = nn.Sequential(nn.AdaptiveAvgPool2d(4), nn.Flatten(), nn.Linear(48, 5)).eval()
    images = torch.rand(n, 3, 16, 16)
    with torch.no_grad():
        labels = model(images).argmax(1)
    return {"untrained": (model, [(images, labels)], Scene.preset("screen_photo"))}


def main() -> None:
    parser = measure.arguments(__doc__)
    parser.add_argument("runs", nargs="*", help="folders of runs; none with --quick")
    args, settings, _ = measure.begin(parser, FULL_SETTINGS, QUICK_SETTINGS)
    if not args.runs and not args.quick:
        parser.error("name folders of runs, as in runs/baseline/seed0 runs/moire_at/seed0")
    n = settings["n"]
    try:
        models = models_of(args.runs, n) if args.runs else quick_model(n)
    except ValueError as error:
        parser.error(str(error))
    rows, chosen = [], []
    for name, (model, batches, scene) in models.items():
        of_run = measure_run(model, batches, scene, settings)
        best = recommended(of_run)
        chosen.append(
            f"{name}: cheapest within a point of the lowest accuracy: {best['attacker']}, "
            f"{best['steps']} steps"
        )
        rows += [{"run": name} | row for row in of_run]
    measure.publish(pd.DataFrame(rows), measure.results(args) / "attack_budget.csv")
    print("", *chosen, sep="\n")


if __name__ == "__main__":
    main()
