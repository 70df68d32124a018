"""What accuracy costs in time: every exposure method, on the same problems, against brute force in
float64.

    python benchmarks/accuracy_vs_time.py

Writes and prints results/accuracy_vs_time.csv, a row per problem and method, and draws it as
docs/accuracy_vs_time.png.

Errors are those of the raw reading, in % of its mean; ciede2000 is the mean colour difference of
the developed photos, all exposed so that they are as bright as the picture. The brute force
averages n x n points of every aperture; the error left in it is estimated from n / 2, and is a part
of every error that is not the method's. Times are those that `moireaug.expose` in float32 spends
on a core, so that other load hardly matters, with plans made and caches warm. The engine runs
point and spectral, and what auto chooses of these; the others run in the reference.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))  # run from anywhere, installed or not

import pandas as pd
import torch
from matplotlib.figure import Figure
from torch import Tensor

from benchmarks import measure
from benchmarks.problems import PROBLEMS, Problem, images, problem
from moireaug import Scene, Shot, develop, expose
from moireaug.evaluation.visibility import visibility

METHODS: dict[str, dict[str, Any]] = {
    "point": {"exposure": "point"},
    "supersample:2": {"exposure": "supersample:2"},
    "supersample:4": {"exposure": "supersample:4"},
    "supersample:8": {"exposure": "supersample:8"},
    "supersample:16": {"exposure": "supersample:16"},
    "spectral 1/64": {"exposure": "spectral", "tolerance": 1 / 64},
    "spectral 1/512": {"exposure": "spectral", "tolerance": 1 / 512},
    "spectral 1/4096": {"exposure": "spectral", "tolerance": 1 / 4096},
    "box": {"exposure": "box"},
    "auto": {"exposure": "auto"},
}
FULL_SETTINGS: dict[str, Any] = {
    "problems": PROBLEMS,
    "sensor_pixels": 120,
    "batch": 4,
    "points": 96,
    "repeats": 9,
    "warmup": 1,
}
QUICK_SETTINGS: dict[str, Any] = {
    "problems": PROBLEMS[1:2],
    "sensor_pixels": 24,
    "batch": 1,
    "points": 12,
    "repeats": 1,
    "warmup": 0,
}
BUDGET_SECONDS = 1.0  # of a method on a problem
STYLES = {  # Okabe and Ito (2008), told apart by every common kind of colour vision
    "supersample": ("#0072B2", "o"),
    "point": ("#D55E00", "X"),
    "box": ("#CC79A7", "s"),
    "spectral": ("#009E73", "D"),
    "auto": ("#000000", "*"),
}


def main() -> None:
    parser = measure.arguments(__doc__)
    parser.set_defaults(threads=1)
    args, sizes, _ = measure.begin(parser, FULL_SETTINGS, QUICK_SETTINGS)
    rows: list[dict[str, Any]] = []
    for settings in sizes["problems"]:
        rows += solve(problem(**settings), sizes)
    table = pd.DataFrame(rows)
    folder = measure.results(args)
    measure.publish(table, folder / "accuracy_vs_time.csv")
    pictures = ROOT / "docs" if folder == measure.RESULTS else folder
    figure(table).savefig(pictures / "accuracy_vs_time.png", dpi=110)


@torch.no_grad()
def solve(case: Problem, sizes: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the row of every method on one problem."""
    shown = images(case.picture, sizes["batch"], case.side(sizes["sensor_pixels"]))
    shots = {}
    for name, changes in METHODS.items():
        shots[name] = draw(with_method(case.scene, **changes), shown)
    calls = {name: partial(expose, shown, shot) for name, shot in shots.items()}
    times = measure.timed_together(
        calls, sizes["repeats"], sizes["warmup"], BUDGET_SECONDS, time.process_time
    )

    first = shown[:1]
    exact, error_left = converged(case.scene, first, sizes["points"])
    brightness = float(first.mean() / exact.mean())
    photo = developed(exact, draw(case.scene, first), brightness)
    for name, shot in shots.items():
        raw = expose(first, shot[:1]).double()
        error = raw - exact
        seconds = times[name] / len(shown)
        yield {
            "problem": case.title,
            "method": name,
            "plan": shot.scene.plan().exposure,
            "ms": 1e3 * seconds.median,
            "ms_low": 1e3 * seconds.low,
            "ms_high": 1e3 * seconds.high,
            "rmse_percent": rms(error, exact),
            "max_percent": float(100 * error.abs().max() / exact.mean()),
            "ciede2000": visibility(developed(raw, shot[:1], brightness), photo)["ciede2000"][0],
            "brute_force_percent": error_left,
        }


def with_method(scene: Scene, exposure: str, tolerance: float | None = None) -> Scene:
    return replace(
        scene,
        sensor=replace(scene.sensor, exposure=exposure),
        tolerance=tolerance or scene.tolerance,
    )


def draw(scene: Scene, shown: Tensor) -> Shot:
    return scene.sample(len(shown), tuple(shown.shape[-2:]))


def converged(scene: Scene, shown: Tensor, n: int) -> tuple[Tensor, float]:
    """Return the brute force's reading in float64, and the error left in it, in %.

    At first order, the slowest that edges allow, the error halves from n / 2 to n. Errors at edges
    have no common sign, so the difference of the two readings is sqrt(2^2 + 1) times the error left
    in the finer one: Richardson's estimate in the mean square.
    """
    light = shown.double()
    coarse, fine = (
        expose(light, draw(with_method(scene, f"supersample:{m}"), light)) for m in (n // 2, n)
    )
    return fine, rms(fine - coarse, fine) / math.sqrt(5)


def rms(difference: Tensor, reference: Tensor) -> float:
    """Return the root mean square in % of the reference's mean."""
    return float(100 * difference.square().mean().sqrt() / reference.mean())


def developed(raw: Tensor, shot: Shot, brightness: float) -> Tensor:
    return (develop(raw, shot) * brightness).clamp(0, 1)


def figure(table: pd.DataFrame) -> Figure:
    """Return error over time: a pale mark a problem, and each method's medians."""
    fig = Figure(figsize=(7, 4.4), layout="constrained", facecolor="white")
    axes = fig.subplots()
    family = table["method"].str.split("[: ]").str[0]
    for name, (colour, marker) in STYLES.items():
        rows = table[family == name]
        middle = rows.groupby("method", sort=False)[["ms", "rmse_percent"]].median()
        axes.plot(middle["ms"], middle["rmse_percent"], f"{marker}-", color=colour, label=name)
        axes.scatter(rows["ms"], rows["rmse_percent"], 16, colour, marker=marker, alpha=0.25)
    axes.set(xscale="log", yscale="log", xlabel="time of an image on a core, ms")
    axes.set_ylabel("RMSE of the raw reading, % of its mean")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
    axes.grid(color="#DDDDDD", linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, ncols=len(STYLES), loc="lower center", bbox_to_anchor=(0.5, 1))
    return fig


if __name__ == "__main__":
    main()
