"""What binned readings cost in accuracy, and save in time, against full ones.

    python benchmarks/bins.py --threads 1

Photographs a part of a portrait without noise at several pitches, numbers of sensor pixels a photo
pixel, views, layouts and tolerances, once with a value for each sensor pixel and once binned.
Errors are the root mean square against the full reading at a tolerance of 1/8192, and the moiré is
that of the photo less its twin without moiré, both in codes of 255. Times are of one photo by
`moireaug.capture` in float32, full and binned in turns, with plans made and caches warm.

Prints tables and writes results/bins.json.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

import pandas as pd
import torch
from torch import Tensor

from benchmarks import measure
from benchmarks.problems import VIEWS, images
from moireaug import Develop, Lens, Panel, Scene, Sensor, View, capture
from moireaug.synthesis import without_moire

CAMERAS = {"frontal": View(), "turned by 3 degrees": View(roll=3.0), "oblique": VIEWS["oblique"]}
BLUR = 0.4  # sensor pixels
READINGS = ("full", "binned")
TOLERANCES = (1 / 2048, 1 / 512, 1 / 128)
DEFAULT_TOLERANCE = 1 / 512  # the default of a scene
EXACT_TOLERANCE = 1 / 8192
FULL_SETTINGS: dict[str, Any] = {
    "pitches": (1.2, 1.6, 2.0, 2.4),
    "scales": (2, 3, 4, 6, 8, 12),
    "views": tuple(CAMERAS),
    "layouts": ("rgb_stripe", "pentile_diamond", "led", "chevron"),
    "side": 96,
    "repeats": 7,
    "warmup": 1,
}
QUICK_SETTINGS: dict[str, Any] = {
    "pitches": (2.4,),
    "scales": (2, 4),
    "views": ("oblique",),
    "layouts": ("rgb_stripe",),
    "side": 32,
    "repeats": 1,
    "warmup": 0,
}
CAPTION = """Medians over the problems; RMS in codes of 255, ms a photo, full over binned.
scale: sensor pixels a photo pixel; pitch: sensor pixels a panel pixel."""


@dataclass(frozen=True)
class Problem:
    """A screen in front of a camera.

    Args:
        pitch: sensor pixels per panel pixel, if the view were frontal and edge to edge.
        scale: sensor pixels per photo pixel.
        view: a key of `CAMERAS`.
        layout: of the panel.
    """

    pitch: float
    scale: int
    view: str
    layout: str

    def scene(self, reading: str, tolerance: float) -> Scene:
        return Scene(
            panel=Panel(scale=self.scale / self.pitch, layout=self.layout),
            view=CAMERAS[self.view],
            lens=Lens(blur=BLUR),
            sensor=Sensor(scale=self.scale, reading=reading),
            develop=Develop(registered=False),  # bins would be read in the image's frame
            tolerance=tolerance,
        )


def problems(settings: dict[str, Any]) -> Iterator[Problem]:
    names = ("pitches", "scales", "views", "layouts")
    for values in product(*(settings[name] for name in names)):
        yield Problem(*values)


@torch.no_grad()
def solve(problem: Problem, shown: Tensor, settings: dict[str, Any]) -> list[dict[str, Any]]:
    """Return a row for each tolerance: errors and times of both readings, and the strength of the
    moiré."""
    size = (shown.shape[-2], shown.shape[-1])
    shot = problem.scene("full", EXACT_TOLERANCE).sample(1, size)
    exact, twin = capture(shown, shot), capture(shown, without_moire(shot))
    shots = {}
    for reading, tolerance in product(READINGS, TOLERANCES):
        scene = problem.scene(reading, tolerance)
        shots[reading, tolerance] = replace(shot, scene=scene)
    calls = {}
    for (reading, tolerance), one in shots.items():
        calls[f"{reading} {tolerance}"] = lambda one=one: capture(shown, one)
    times = measure.timed_together(calls, settings["repeats"], settings["warmup"])
    rows = []
    for tolerance in TOLERANCES:
        row: dict[str, Any] = vars(problem) | {"tolerance": tolerance}
        row["moire"] = rms(exact - twin)
        for reading in READINGS:
            row[f"{reading}_error"] = rms(capture(shown, shots[reading, tolerance]) - exact)
            row[f"{reading}_ms"] = 1e3 * times[f"{reading} {tolerance}"].median
        row["times_as_fast"] = row["full_ms"] / row["binned_ms"]
        rows.append(row)
    return rows


def rms(difference: Tensor) -> float:
    """Return the root mean square in codes of 255, over the middle of photos: in the camera's frame
    the picture has dark surroundings."""
    edge = difference.shape[-1] // 8
    return float(255 * difference[..., edge:-edge, edge:-edge].square().mean().sqrt())


def summary(table: pd.DataFrame, key: str) -> pd.DataFrame:
    """Return a line for each value of a key: medians over the problems that have it, the largest
    error, and the quartiles of how many times as fast binned is."""
    groups = table.groupby(key, sort=False)
    faster = groups["times_as_fast"]
    columns = {
        "problems": groups.size(),
        "moiré": groups["moire"].median(),
        "error of binned": groups["binned_error"].median(),
        "largest": groups["binned_error"].max(),
        "ms full": groups["full_ms"].median(),
        "ms binned": groups["binned_ms"].median(),
        "times as fast": faster.median(),
        "from": faster.quantile(0.25),
        "to": faster.quantile(0.75),
    }
    return pd.DataFrame(columns).reset_index()


def main() -> None:
    args, settings, facts = measure.begin(measure.arguments(__doc__), FULL_SETTINGS, QUICK_SETTINGS)
    shown = images("photo", 1, settings["side"])
    rows = []
    for problem in problems(settings):
        rows += solve(problem, shown, settings)
    table = pd.DataFrame(rows)
    usual = table[table["tolerance"] == DEFAULT_TOLERANCE]
    print(CAPTION)
    for key in ("scale", "pitch", "view", "layout"):
        print(f"\n{measure.text_of(summary(usual, key))}")
    print(f"\n{measure.text_of(summary(table, 'tolerance'))}")
    measure.write_json(args, "bins", metadata=facts, settings=settings, rows=rows)


if __name__ == "__main__":
    main()
