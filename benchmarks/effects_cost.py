"""What each effect costs: every preset built up field by field, in the order in which light meets them.

    python benchmarks/effects_cost.py

Starts from a frontal screen at the preset's sensor scale. A line is the capture with one more field set as the preset
has it; fields that a scene refuses one without the other come together. Prints a table for each preset and writes
results/effects_cost.json. Times are of `moireaug.capture` in float32 without gradients, shots drawn and plans made.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

import torch

from benchmarks import measure
from benchmarks.problems import images
from moireaug import Scene, Sensor, capture
from moireaug.scene.parts import PARTS
from moireaug.scene.presets import PRESETS

FULL = {"side": 128, "batch": 8, "repeats": 15, "budget": 1.0}
QUICK = {"side": 8, "batch": 1, "repeats": 1, "budget": 0.0}


def main() -> None:
    args = measure.arguments(__doc__).parse_args()
    torch.set_num_threads(args.threads)
    facts, settings = measure.metadata(), QUICK if args.quick else FULL
    print(measure.told(facts))
    print(f"{settings['batch']} images of {settings['side']} x {settings['side']}", end="\n\n")
    found = {}
    for name in PRESETS:
        found[name] = build_up(Scene.preset(name), settings)
        print(report(name, found[name]), end="\n\n", flush=True)
    measure.write_json(args.out / "effects_cost.json", {"metadata": facts, "settings": settings, "presets": found})


@torch.no_grad()
def build_up(scene: Scene, settings: dict[str, Any]) -> list[dict[str, Any]]:
    """A row for each field added, with the time of one image."""
    torch.manual_seed(0)
    shown = images("photo", settings["batch"], settings["side"])
    stages = list(growing(scene))
    shots = [stage.sample(len(shown), tuple(shown.shape[-2:])) for _, stage in stages]
    calls = {str(i): lambda shot=shot: capture(shown, shot) for i, shot in enumerate(shots)}
    times = measure.timed_together(calls, settings["repeats"], budget=settings["budget"])
    return [
        {"added": added, "effects": [step.name for step in stage.plan()], "exposure": stage.plan().exposure,
         "seconds": (times[str(i)] / len(shown))._asdict()}
        for i, (added, stage) in enumerate(stages)
    ]  # fmt: skip


def growing(scene: Scene) -> Iterator[tuple[dict[str, Any], Scene]]:
    """What is added, and the scene with it and all before: from the sensor's scale alone to the whole scene."""
    built = Scene(sensor=Sensor(scale=scene.sensor.scale), tolerance=scene.tolerance)
    yield {"sensor.scale": scene.sensor.scale}, built
    waiting: dict[str, dict[str, Any]] = {}
    for part in PARTS:
        for field in fields(getattr(scene, part)):
            value = getattr(getattr(scene, part), field.name)
            if value == getattr(getattr(built, part), field.name):
                continue
            waiting.setdefault(part, {})[field.name] = value
            try:
                built = replace(built, **{p: replace(getattr(built, p), **new) for p, new in waiting.items()})
            except ValueError:
                continue  # it needs another field beside it
            yield {f"{p}.{k}": v for p, new in waiting.items() for k, v in new.items()}, built
            waiting = {}


def report(preset: str, rows: list[dict[str, Any]]) -> str:
    """One preset's table."""
    lines, before = [], None
    for row in rows:
        median, quartiles = measure.in_ms(row["seconds"])
        added = ", ".join(f"{name} {value(v)}" for name, v in row["added"].items())
        more = before and f"{median - before:+.2f}"
        lines.append((added, row["exposure"], len(row["effects"]), median, quartiles, more))
        before = median
    return measure.table((preset, "exposure", "effects", "ms an image", "quartiles", "more"), lines)


def value(v: Any) -> str:
    if isinstance(v, tuple):
        return " to ".join(f"{end:g}" for end in v)
    return f"{v:g}" if isinstance(v, float) else str(v)


if __name__ == "__main__":
    main()
