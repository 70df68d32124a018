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

from benchmarks import checkouts, measure, plots
from benchmarks.colour import visible_difference
from benchmarks.problems import SET, Problem, images, problem
from benchmarks.runs import WITHOUT, runs_of
from moireaug import Scene, Shot, develop, expose

SAMPLES = (2, 4, 8, 16)
TOLERANCES = {"1/64": 1 / 64, "1/512": 1 / 512, "1/4096": 1 / 4096}
METHODS: dict[str, dict[str, Any]] = {
    "point": {"exposure": "point"},
    **{f"supersample:{n}": {"exposure": f"supersample:{n}"} for n in SAMPLES},
    **{f"spectral {t}": {"exposure": "spectral", "tolerance": v} for t, v in TOLERANCES.items()},
    "box": {"exposure": "box"},
    "auto": {"exposure": "auto"},
}
WITHIN, AT_MOST = 1.0, 2.0  # bars of auto: RMSE in %, and time over that of WITHOUT
SAME = 1.02  # errors within this factor count as equal: they vary with the picture
FULL = {"problems": 1, "sensor_pixels": 120, "batch": 8, "points": 96, "repeats": 15, "budget": 1.5}
QUICK = {"problems": 4, "sensor_pixels": 24, "batch": 1, "points": 12, "repeats": 1, "budget": 0.0}


def main() -> None:
    parser = measure.arguments(__doc__)
    checkouts.add_before(parser)
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    facts, settings = measure.metadata(), QUICK if args.quick else FULL
    print(measure.told(facts), end="\n\n")
    found = []
    with ExitStack() as stack:
        before = (
            stack.enter_context(checkouts.Checkout(args.before, args.threads))
            if args.before
            else None
        )
        for numbers in SET[:: settings["problems"]]:
            found.append(solve(problem(**numbers), settings, before))
            print(report(found[-1]), end="\n\n", flush=True)
    print(summary(found))
    facts |= {"before": checkouts.commit(args.before)}
    measure.write_json(
        args.out / "accuracy_vs_time.json",
        {"metadata": facts, "settings": settings, "problems": found},
    )
    plots.accuracy_vs_time(found, args.out / "accuracy_vs_time.png")


@torch.no_grad()
def solve(
    problem: Problem, settings: dict[str, Any], before: checkouts.Checkout | None = None
) -> dict[str, Any]:
    """Run every method on one problem; return its rows, and the brute force's own convergence."""
    shown = images(problem.picture, settings["batch"], problem.side(settings["sensor_pixels"]))
    first = shown[:1]
    shots = {
        name: draw(with_method(problem.scene, **wanted), shown) for name, wanted in METHODS.items()
    }
    exact, brute = converged(problem.scene, first, settings["points"])
    runs = runs_of(shots, shown, before)
    calls = {name: run.timed for name, run in runs.items()}
    times = measure.timed_together(calls, settings["repeats"], budget=settings["budget"])
    brightness = float(first.mean() / exact.mean())
    lit = developed(exact, draw(problem.scene, first), brightness)
    rows = []
    for name, run in runs.items():
        raw = run.reading().double()
        seen = visible_difference(developed(raw, run.shot[:1], brightness), lit)
        plan = run.shot.scene.plan()
        rows.append(
            {"method": name, "by": run.by, "plan": plan.exposure}
            | {"samples": samples(plan.exposure, len(plan.harmonics))}
            | {
                "seconds": (times[name] / len(shown))._asdict(),
                "rmse_percent": rms(raw - exact, exact),
            }
            | {
                "max_percent": float(100 * (raw - exact).abs().max() / exact.mean()),
                "delta_e": float(seen.mean()),
            }
        )
    floor = brute["error_left_percent"]
    rows = [row | {"frontier": not beaten_by(row, rows, floor)} for row in rows]
    return {
        "title": problem.title,
        "pitch": problem.pitch,
        "size": list(shown.shape),
        "scene": problem.scene.to_dict(),
        "brute_force": brute,
        "rows": rows,
        "auto": judge(rows, floor),
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
    scenes = (with_method(scene, f"supersample:{m}") for m in (n // 4, n // 2, n))
    coarse, middle, fine = (expose(light, draw(s, light)) for s in scenes)
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
    more than `SAME`; errors below the floor count as the floor."""
    error, time = max(row["rmse_percent"], floor), row["seconds"]["low"]
    faster = [other for other in rows if other["seconds"]["high"] < time]
    return [other["method"] for other in faster if max(other["rmse_percent"], floor) * SAME < error]


def judge(rows: list[dict[str, Any]], floor: float) -> dict[str, Any]:
    """Return what auto chose, what beats it, and how many times its time the cheapest supersampling
    takes that is as accurate, or the finest where none is."""
    auto = next(row for row in rows if row["method"] == "auto")
    brute = [row for row in rows if row["method"].startswith("supersample")]
    enough = max(auto["rmse_percent"], floor) * SAME
    able = [row for row in brute if row["rmse_percent"] <= enough]
    rival = min(able, key=lambda row: row["seconds"]["median"]) if able else brute[-1]
    without = [row["seconds"]["median"] for row in rows if row["method"] == WITHOUT]
    return {
        "within": auto["rmse_percent"] <= math.hypot(WITHIN, floor),
        "rmse_percent": auto["rmse_percent"],
        "over_without": auto["seconds"]["median"] / without[0] if without else None,
        "chosen": auto["plan"],
        "beaten_by": beaten_by(auto, rows, floor),
        "rival": rival["method"],
        "rival_is_as_accurate": bool(able),
        "times_as_fast": rival["seconds"]["median"] / auto["seconds"]["median"],
    }


def report(result: dict[str, Any]) -> str:
    """Return one problem's table."""
    brute, n = result["brute_force"], result["size"]
    order = brute["order_seen"]
    head = (
        f"{result['title']}; {n[0]} images of {n[2]} x {n[3]}\n"
        f"  brute force {brute['method']}, {brute['dtype']}: "
        f"{brute['difference_to_half_percent']:.2g} % from half of n, so about "
        f"{brute['error_left_percent']:.2g} % is left"
        f"{f'; order seen {order:.1f}' if order is not None else ''}"
    )
    columns = (
        "method",
        "by",
        "samples",
        "ms an image",
        "quartiles",
        "RMSE %",
        "max %",
        "dE",
        "frontier",
    )
    lines = []
    for row in result["rows"]:
        name = f"auto = {row['plan']}" if row["method"] == "auto" else row["method"]
        errors = row["rmse_percent"], row["max_percent"], row["delta_e"]
        lines.append(
            (
                name,
                row["by"],
                row["samples"],
                *measure.in_ms(row["seconds"]),
                *errors,
                "*" if row["frontier"] else "",
            )
        )
    return head + "\n" + measure.table(columns, lines)


def summary(found: list[dict[str, Any]]) -> str:
    """Return a table of auto against its bars and the other methods, one line per problem."""
    rows = []
    for result in found:
        auto = result["auto"]
        beaten = "on the frontier"
        if auto["beaten_by"]:
            beaten = f"beaten by {', '.join(auto['beaten_by'])}"
        speed = f"{auto['times_as_fast']:.1f} x {auto['rival']}"
        if not auto["rival_is_as_accurate"]:
            speed = f"more than {speed}"
        left = result["brute_force"]["error_left_percent"]
        rows.append(
            (
                result["title"],
                auto["chosen"],
                auto["rmse_percent"],
                left,
                auto["within"],
                auto["over_without"],
                beaten,
                speed,
            )
        )
    good = sum(not result["auto"]["beaten_by"] for result in found)
    close = sum(result["auto"]["within"] for result in found)
    quick = sum((result["auto"]["over_without"] or math.inf) <= AT_MOST for result in found)
    aims = f"within {WITHIN:g} %"
    columns = (
        "problem",
        "auto takes",
        "RMSE %",
        "brute %",
        aims,
        "time, x one panel pixel",
        "auto is",
        "as fast as",
    )
    return (
        f"{measure.table(columns, rows)}\nbrute % is the error left in the brute force: a part of "
        f"the RMSE that is not auto's\nauto is {aims} on {close} of {len(found)} "
        f"problems, takes at most {AT_MOST:g} times as long as with one panel pixel on {quick}, "
        f"and is on the frontier of {good}"
    )


if __name__ == "__main__":
    main()
