"""A preset built up field by field: what each field adds to the time of a capture."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from typing import Any

import torch

from benchmarks import measure
from benchmarks.executions import EXECUTIONS, in_both, taking
from benchmarks.problems import images
from moireaug import Scene, Sensor
from moireaug.scene.by_name import with_values
from moireaug.scene.fields import bounds
from moireaug.scene.parts import PARTS


@torch.no_grad()
def rows_of(scene: Scene, settings: dict[str, Any]) -> list[dict[str, Any]]:
    """Return a row for each field added, with the time of one image."""
    shown = images("photo", *settings["build_up"])
    size = shown.shape[-2], shown.shape[-1]
    stages = list(growing(scene))
    calls = {str(i): taking(stage, shown) for i, (_, stage) in enumerate(stages)}
    times = in_both(calls, settings, len(shown))
    rows = []
    for i, (added, stage) in enumerate(stages):
        plan = stage.plan(size)
        row: dict[str, Any] = {"added": added}
        row["effects"] = [step.name for step in plan.called]
        row["exposure"] = plan.exposure
        for execution in EXECUTIONS:
            row[execution] = times[execution][str(i)]._asdict()
        rows.append(row)
    return rows


def growing(scene: Scene) -> Iterator[tuple[dict[str, Any], Scene]]:
    """Yield what is added, and the scene with it and all before: from the sensor's pitch, or its
    scale where no pitch is stated, to the whole scene."""
    first = "pitch" if bounds(scene.sensor.pitch)[1] else "scale"
    stated = getattr(scene.sensor, first)
    built = Scene(sensor=Sensor(**{first: stated}), tolerance=scene.tolerance)
    yield {f"sensor.{first}": stated}, built
    added: dict[str, Any] = {}
    for part in PARTS:
        for field in fields(getattr(scene, part)):
            value = getattr(getattr(scene, part), field.name)
            if value == getattr(getattr(built, part), field.name):
                continue
            added[f"{part}.{field.name}"] = value
            try:
                built = with_values(built, added)
            except ValueError:
                continue  # it needs another field beside it
            yield added, built
            added = {}


def report(preset: str, rows: list[dict[str, Any]]) -> str:
    """Return one preset's table."""
    columns = (preset, "exposure", "effects", "engine, ms an image", "quartiles", "more")
    lines = []
    before = None
    for row in rows:
        engine, quartiles = measure.in_ms(row["engine"])
        reference, _ = measure.in_ms(row["reference"])
        more = "", ""
        if before:
            more = f"{engine - before[0]:+.2f}", f"{reference - before[1]:+.2f}"
        before = engine, reference
        added = ", ".join(f"{name} {as_text(value)}" for name, value in row["added"].items())
        ours = (engine, quartiles, more[0])
        lines.append((added, row["exposure"], len(row["effects"]), *ours, reference, more[1]))
    return measure.table((*columns, "reference, ms", "more"), lines)


def as_text(value: Any) -> str:
    if isinstance(value, tuple):
        return " to ".join(f"{end:g}" for end in value)
    return f"{value:g}" if isinstance(value, float) else str(value)
