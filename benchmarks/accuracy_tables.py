"""The tables that `accuracy_vs_time` prints: one for each problem, and a summary."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from benchmarks import measure

MAX_AUTO_TIME = 2.0  # bar of auto's time, in that of one panel pixel a sensor pixel
METHOD_COLUMNS = (
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


def report(result: dict[str, Any]) -> str:
    """Return one problem's table, of a result of `accuracy_vs_time.solve`."""
    rows = [_method(row) for row in result["rows"]]
    return f"{_heading(result)}\n{measure.table(METHOD_COLUMNS, rows)}"


def _heading(result: dict[str, Any]) -> str:
    brute = result["brute_force"]
    n, _, h, w = result["size"]
    last, left = brute["difference_to_half_percent"], brute["error_left_percent"]
    text = f"{result['title']}; {n} images of {h} x {w}\n"
    text += f"  brute force {brute['method']}, {brute['dtype']}: "
    text += f"{last:.2g} % from half of n, so about {left:.2g} % is left"
    if brute["order_seen"] is not None:
        text += f"; order seen {brute['order_seen']:.1f}"
    return text


def _method(row: dict[str, Any]) -> tuple[Any, ...]:
    name = row["method"]
    if name == "auto":
        name = f"auto = {row['plan']}"
    milliseconds, quartiles = measure.in_ms(row["seconds"])
    return (
        name,
        row["by"],
        row["samples"],
        milliseconds,
        quartiles,
        row["rmse_percent"],
        row["max_percent"],
        row["delta_e"],
        "*" if row["frontier"] else "",
    )


def summary(found: Sequence[dict[str, Any]], within: float) -> str:
    """Return a table of auto against its bars and the other methods, one line per problem.

    Args:
        found: results of `accuracy_vs_time.solve`.
        within: bar of auto's RMSE, in %.
    """
    columns = (
        "problem",
        "auto takes",
        "RMSE %",
        "brute %",
        f"within {within:g} %",
        "time, x one panel pixel",
        "auto is",
        "as fast as",
    )
    close = quick = best = 0
    for result in found:
        auto = result["auto"]
        over = auto["over_without"]
        close += auto["within"]
        quick += over is not None and over <= MAX_AUTO_TIME
        best += not auto["beaten_by"]
    table = measure.table(columns, [_problem(result) for result in found])
    return (
        f"{table}\n"
        "brute % is the error left in the brute force: a part of the RMSE that is not auto's\n"
        f"auto is within {within:g} % on {close} of {len(found)} problems, takes at most "
        f"{MAX_AUTO_TIME:g} times as long as with one panel pixel on {quick}, and is on the "
        f"frontier of {best}"
    )


def _problem(result: dict[str, Any]) -> tuple[Any, ...]:
    auto = result["auto"]
    place = "on the frontier"
    if auto["beaten_by"]:
        place = f"beaten by {', '.join(auto['beaten_by'])}"
    speed = f"{auto['times_as_fast']:.1f} x {auto['rival']}"
    if not auto["rival_is_as_accurate"]:
        speed = f"more than {speed}"
    return (
        result["title"],
        auto["chosen"],
        auto["rmse_percent"],
        result["brute_force"]["error_left_percent"],
        auto["within"],
        auto["over_without"],
        place,
        speed,
    )
