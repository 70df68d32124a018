"""A preset built up field by field: what each field adds to the time of a capture."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace
from typing import Any

import torch

from benchmarks import measure
from benchmarks.executions import EXECUTIONS, in_both, taking
from benchmarks.problems import images
from moireaug import Scene, Sensor
from moireaug.scene.fields import bounds
from moireaug.scene.parts import PARTS


@torch.no_grad()
def rows_of(scene: Scene, settings: dict[str, Any]) -> list[dict[str, Any]]:
    """Return a row for each field added, with the time of one image."""
    shown = images("photo", *settings["build_up"])
    stages = list(growing(scene))
    calls = {}
    for i, (_, stage) in enumerate(stages):
        calls[str(i)] = taking(stage, shown)
    times = in_both(calls, settings, len(shown))
    rows = []
    for i, (added, stage) in enumerate(stages):
        plan = stage.plan((shown.shape[-2], shown.shape[-1]))
        row = {
            "added": added,
            "effects": [step.name for step in plan.called],
            "exposure": plan.exposure,
        }
        rows.append(
            row | {execution: times[execution][str(i)]._asdict() for execution in EXECUTIONS}
        )
    return rows


def growing(scene: Scene) -> Iterator[tuple[dict[str, Any], Scene]]:
    """Yield what is added, and the scene with it and all before: from the sensor's pitch, or its
    scale where no pitch is stated, to the whole scene."""
    first = "pitch" if bounds(scene.sensor.pitch)[1] else "scale"
    stated = {first: getattr(scene.sensor, first)}
    built = Scene(sensor=Sensor(**stated), tolerance=scene.tolerance)
    yield {f"sensor.{first}": stated[first]}, built
    waiting: dict[str, dict[str, Any]] = {}
    for part in PARTS:
        for field in fields(getattr(scene, part)):
            value = getattr(getattr(scene, part), field.name)
            if value == getattr(getattr(built, part), field.name):
                continue
            waiting.setdefault(part, {})[field.name] = value
            try:
                built = replace(
                    built, **{p: replace(getattr(built, p), **new) for p, new in waiting.items()}
                )
            except ValueError:
                continue  # it needs another field beside it
            yield {f"{p}.{k}": v for p, new in waiting.items() for k, v in new.items()}, built
            waiting = {}


def report(preset: str, rows: list[dict[str, Any]]) -> str:
    """Return one preset's table."""
    lines, before = [], None
    for row in rows:
        added = ", ".join(f"{name} {value(v)}" for name, v in row["added"].items())
        median, quartiles = measure.in_ms(row["engine"])
        plain, _ = measure.in_ms(row["reference"])
        more = (
            [f"{new - old:+.2f}" for new, old in zip((median, plain), before, strict=True)]
            if before
            else ["", ""]
        )
        lines.append(
            (
                added,
                row["exposure"],
                len(row["effects"]),
                median,
                quartiles,
                more[0],
                plain,
                more[1],
            )
        )
        before = (median, plain)
    columns = (
        preset,
        "exposure",
        "effects",
        "engine, ms an image",
        "quartiles",
        "more",
        "reference, ms",
        "more",
    )
    return measure.table(columns, lines)


def value(v: Any) -> str:
    if isinstance(v, tuple):
        return " to ".join(f"{end:g}" for end in v)
    return f"{v:g}" if isinstance(v, float) else str(v)
