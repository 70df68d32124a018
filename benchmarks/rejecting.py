"""A classifier that rejects what a detector of screen photos flags, attacked with and without
knowledge of the detector.

    python benchmarks/rejecting.py runs/baseline/seed0 runs/moire_at/seed0

The detector is a small network, trained here on each run's own training images: photos in the run's
scenes against the images and their photos without moiré, all as JPEG. Its threshold rejects 5 % of
the validation images. Prints a row per attack: what is rejected, what fools the model and is let
through, and the accuracy of what is let through. Writes results/rejecting.csv.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

import pandas as pd
import torch
from torch import Tensor, nn
from torch.nn.functional import cross_entropy

from benchmarks import measure
from moireaug import capture, evaluation
from moireaug.defenses import JPEG, Rejecting
from moireaug.evaluation.tables import eps_row
from moireaug.mixtures import scenes_of
from moireaug.scenes import Scene
from moireaug.synthesis import without_moire
from training.attack.protocol import protocol_of
from training.data.load import load
from training.models.small_resnet import SmallResNet
from training.runs import trained
from training.suites.paper import transfer

FULL_SETTINGS: dict[str, Any] = {"n": 480, "steps": 20, "batches": 400}
QUICK_SETTINGS: dict[str, Any] = {"n": 4, "steps": 1, "batches": 2}
BATCH = 32
FALSE_ALARMS = 0.05
EPS = 4 / 255


class Detector(nn.Module):
    """Scores (B,) of images (B, 3, H, W): the log-odds that one is a photo of a screen."""

    def __init__(self) -> None:
        super().__init__()
        self.network = SmallResNet(2)

    def forward(self, images: Tensor) -> Tensor:
        other, screen = self.network(images).unbind(1)
        return screen - other


def train_detector(images: Tensor, scenes: Sequence[Scene], batches: int) -> Detector:
    """Train on photos of images (N, 3, S, S) in [0, 1], in the scenes in turn, against the images
    and their twins."""
    detector = Detector()
    optimizer = torch.optim.AdamW(detector.parameters(), 2e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 4e-3, total_steps=batches)
    kinds = torch.tensor([1, 0, 0]).repeat_interleave(BATCH)
    for k in range(batches):
        chosen = images[torch.randint(len(images), (BATCH,))]
        shot = scenes[k % len(scenes)].sample(BATCH, tuple(images.shape[-2:]))
        photos = [capture(chosen, shot), capture(chosen, without_moire(shot))]
        shown = torch.cat([*photos, chosen])
        shown = JPEG(int(torch.randint(60, 96, ())))(shown)
        logits = detector.network(shown)
        loss = cross_entropy(logits, kinds, weight=torch.tensor([0.5, 1.0]))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    return detector.eval()


def stacked(data: Any, n: int) -> Tensor:
    """Return the first n images of a data set, (n, 3, S, S) in [0, 1]."""
    return torch.stack([data[i][0] for i in range(min(n, len(data)))]).float() / 255


def outcome_rows(frame: pd.DataFrame, attacker: str) -> list[dict[str, Any]]:
    """Return a row for each cell of a frame: shares of all its images."""
    rows = []
    for row in evaluation.rates(frame).to_dict("records"):
        passed = row["n"] - row["rejected"]
        right = row["accuracy"] * row["n"]
        rows.append(
            {
                "attacker": attacker,
                "condition": row["condition"],
                "n": row["n"],
                "rejected": row["rejected"] / row["n"],
                "fooled": (passed - right) / row["n"],
                "accuracy_of_passed": right / passed if passed else float("nan"),
            }
        )
    return rows


def measure_run(folder: Path, sizes: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the rows of a run's classifier behind a detector."""
    torch.manual_seed(0)
    run = trained.read(folder)
    run.cfg.reattack.n = sizes["n"]
    splits = load(run.cfg.data)
    protocol = protocol_of(run.cfg, splits)
    model, scene, steps = run.model(), protocol.scene, sizes["steps"]
    detector = train_detector(stacked(splits.train, 4000), scenes_of(scene), sizes["batches"])
    with torch.no_grad():
        scores = torch.cat([detector(part) for part in stacked(splits.val, 320).split(64)])
    rejecting = Rejecting(model, detector, scores.quantile(1 - FALSE_ALARMS))
    batches = [protocol.batches[i] for i in range(len(protocol.batches))]
    aware = evaluation.evaluate(rejecting, batches, "worst_case", scene, steps=steps)
    aware = aware[aware["row"] == eps_row(EPS)]
    targets = {"rejecting": rejecting}
    unaware = evaluation.evaluate(
        model, batches, transfer, scene, eps=EPS, steps=steps, targets=targets
    )
    unaware = unaware[(unaware["row"] == "rejecting") & ~unaware["control"]]
    return outcome_rows(aware, "knows the detector") + outcome_rows(unaware, "does not know it")


def main() -> None:
    parser = measure.arguments(__doc__)
    parser.add_argument("runs", nargs="+", type=Path, help="folders of trained runs")
    args, sizes, _ = measure.begin(parser, FULL_SETTINGS, QUICK_SETTINGS)
    rows = []
    for folder in args.runs:
        rows += [{"run": str(folder)} | row for row in measure_run(folder, sizes)]
    measure.publish(pd.DataFrame(rows), measure.results(args) / "rejecting.csv")


if __name__ == "__main__":
    main()
