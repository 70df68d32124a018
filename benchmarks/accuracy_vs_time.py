"""What accuracy costs in time: every exposure method, on the same problems, against brute force in
float64.

    python benchmarks/accuracy_vs_time.py [--before DIR]

Prints a table for each problem and a summary, and writes results/accuracy_vs_time.json and .png.

The engine runs what it can: point and spectral, and what auto chooses of these. The spectral
exposure is also measured with the reference and, with `--before`, in an older checkout. "one panel
pixel" is the engine's auto without the exact aperture: every sensor pixel sees only the panel pixel
in front of its centre, and the picture is not blurred before.

Errors are those of the raw reading, in % of its mean; dE is the mean CIEDE2000 of the developed
photos, all exposed so that they are as bright as the picture. The brute force averages n x n points
of every aperture; the error left in it is estimated from n / 2, and errors below that count as
equal. Times are of `moireaug.expose` in float32, with plans made and caches warm; those of an older
checkout include a tenth of a millisecond for calling its process.
"""

from __future__ import annotations

import math
import sys
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

import torch
from torch import Tensor

from benchmarks import accuracy_tables, checkouts, measure, plots
from benchmarks.colour import visible_difference
from benchmarks.problems import PROBLEMS, Problem, images, problem
from benchmarks.runs import WITHOUT, Run, runs_of
from moireaug import Scene, Shot, develop, expose

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
MAX_AUTO_ERROR = 1.0  # bar of auto's RMSE, in %
EQUAL_ERROR_FACTOR = 1.02  # errors within this factor count as equal: they vary with the picture
FULL = {
    "problems": 1,
    "sensor_pixels": 120,
    "batch": 8,
    "points": 96,
    "repeats": 15,
    "warmup": 1,
    "budget": 1.5,
}
QUICK = {
    "problems": 8,
    "sensor_pixels": 24,
    "batch": 1,
    "points": 12,
    "repeats": 1,
    "warmup": 0,
    "budget": 0.0,
}


def main() -> None:
    parser = measure.arguments(__doc__)
    checkouts.add_before(parser)
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    facts = measure.metadata()
    settings = QUICK if args.quick else FULL
    print(measure.machine_lines(facts), end="\n\n")
    found = []
    with ExitStack() as stack:
        before = None
        if args.before:
            before = stack.enter_context(checkouts.Checkout(args.before, args.threads))
        for numbers in PROBLEMS[:: settings["problems"]]:
            result = solve(problem(**numbers), settings, before)
            print(accuracy_tables.report(result), end="\n\n", flush=True)
            found.append(result)
    print(accuracy_tables.summary(found, MAX_AUTO_ERROR))
    facts["before"] = checkouts.commit(args.before)
    content = {"metadata": facts, "settings": settings, "problems": found}
    measure.write_json(measure.results(args) / "accuracy_vs_time.json", content)
    plots.accuracy_vs_time(found, measure.results(args) / "accuracy_vs_time.png")


@torch.no_grad()
def solve(
    problem: Problem, settings: dict[str, Any], before: checkouts.Checkout | None = None
) -> dict[str, Any]:
    """Run every method on one problem; return its rows, and the brute force's own convergence."""
    shown = images(problem.picture, settings["batch"], problem.side(settings["sensor_pixels"]))
    shots = {}
    for name, wanted in METHODS.items():
        shots[name] = draw(with_method(problem.scene, **wanted), shown)
    runs = runs_of(shots, shown, before)
    calls = {name: run.timed for name, run in runs.items()}
    times = measure.timed_together(
        calls, settings["repeats"], settings["warmup"], settings["budget"]
    )

    first = shown[:1]
    exact, brute = converged(problem.scene, first, settings["points"])
    brightness = float(first.mean() / exact.mean())
    photo = developed(exact, draw(problem.scene, first), brightness)
    rows = []
    for name, run in runs.items():
        row = row_of(name, run, exact, photo, brightness)
        row["seconds"] = (times[name] / len(shown))._asdict()
        rows.append(row)
    floor = brute["error_left_percent"]
    for row in rows:
        row["frontier"] = not beaten_by(row, rows, floor)
    return {
        "title": problem.title,
        "pitch": problem.pitch,
        "size": list(shown.shape),
        "scene": problem.scene.to_dict(),
        "brute_force": brute,
        "rows": rows,
        "auto": judge(rows, floor),
    }


def row_of(name: str, run: Run, exact: Tensor, photo: Tensor, brightness: float) -> dict[str, Any]:
    """Return what a method is and how far its reading is from the exact one, without its time.

    Args:
        exact: the brute force's reading (1, planes, h, w), and `photo` its photo (1, 3, H, W).
        brightness: by which photos are multiplied.
    """
    raw = run.reading().double()
    error = raw - exact
    seen = visible_difference(developed(raw, run.shot[:1], brightness), photo)
    plan = run.shot.scene.plan()
    return {
        "method": name,
        "by": run.by,
        "plan": plan.exposure,
        "samples": samples(plan.exposure, len(plan.harmonics)),
        "rmse_percent": rms(error, exact),
        "max_percent": float(100 * error.abs().max() / exact.mean()),
        "delta_e": float(seen.mean()),
    }


def with_method(scene: Scene, exposure: str, tolerance: float | None = None) -> Scene:
    return replace(
        scene,
        sensor=replace(scene.sensor, exposure=exposure),
        tolerance=tolerance or scene.tolerance,
    )


def draw(scene: Scene, shown: Tensor) -> Shot:
    return scene.sample(len(shown), tuple(shown.shape[-2:]))


def converged(scene: Scene, shown: Tensor, n: int) -> tuple[Tensor, dict[str, Any]]:
    """Return the brute force's reading in float64, and how far it has converged.

    At first order, the slowest that edges allow, the error halves from n / 2 to n. Errors at edges
    have no common sign, so the difference of the two readings is sqrt(2^2 + 1) times the error left
    in the finer one: Richardson's estimate in the mean square. The order seen comes from n / 4,
    too; above 1, less error is left than estimated.
    """
    light = shown.double()
    readings = []
    for m in (n // 4, n // 2, n):
        shot = draw(with_method(scene, f"supersample:{m}"), light)
        readings.append(expose(light, shot))
    coarse, middle, fine = readings
    before, last = rms(middle - coarse, fine), rms(fine - middle, fine)
    return fine, {
        "method": f"supersample:{n}",
        "dtype": "float64",
        "difference_to_half_percent": last,
        "order_seen": math.log2(before / last) if before and last else None,
        "error_left_percent": last / math.sqrt(5),
    }


def rms(difference: Tensor, reference: Tensor) -> float:
    """Return the root mean square in % of the reference's mean."""
    return float(100 * difference.square().mean().sqrt() / reference.mean())


def developed(raw: Tensor, shot: Shot, brightness: float) -> Tensor:
    return (develop(raw, shot) * brightness).clamp(0, 1)


def samples(plan: str, harmonics: int) -> int | None:
    """Return evaluations of the panel per sensor pixel: points of the aperture, or harmonics; None
    for a closed form."""
    method, _, n = plan.partition(":")
    return {"point": 1, "supersample": int(n or 0) ** 2, "spectral": harmonics}.get(method)


def beaten_by(row: dict[str, Any], rows: list[dict[str, Any]], floor: float) -> list[str]:
    """Return the methods that are at once faster, quartile against quartile, and more accurate, by
    more than `EQUAL_ERROR_FACTOR`; errors below the floor count as the floor."""
    error = max(row["rmse_percent"], floor)
    found = []
    for other in rows:
        faster = other["seconds"]["high"] < row["seconds"]["low"]
        if faster and max(other["rmse_percent"], floor) * EQUAL_ERROR_FACTOR < error:
            found.append(other["method"])
    return found


def judge(rows: list[dict[str, Any]], floor: float) -> dict[str, Any]:
    """Return what auto chose, what beats it, and how many times its time the cheapest supersampling
    takes that is as accurate, or the finest where none is."""
    named = {row["method"]: row for row in rows}
    auto = named["auto"]
    seconds = auto["seconds"]["median"]
    enough = max(auto["rmse_percent"], floor) * EQUAL_ERROR_FACTOR
    brute = [row for row in rows if row["method"].startswith("supersample")]
    able = [row for row in brute if row["rmse_percent"] <= enough]
    rival = min(able, key=lambda row: row["seconds"]["median"]) if able else brute[-1]
    over_without = None
    if WITHOUT in named:
        over_without = seconds / named[WITHOUT]["seconds"]["median"]
    return {
        "within": auto["rmse_percent"] <= math.hypot(MAX_AUTO_ERROR, floor),
        "rmse_percent": auto["rmse_percent"],
        "over_without": over_without,
        "chosen": auto["plan"],
        "beaten_by": beaten_by(auto, rows, floor),
        "rival": rival["method"],
        "rival_is_as_accurate": bool(able),
        "times_as_fast": rival["seconds"]["median"] / seconds,
    }


if __name__ == "__main__":
    main()
