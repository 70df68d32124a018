"""What a panel's black matrix, and its lattice altogether, cost the capture."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import torch
from torch import Tensor

from benchmarks.measure import timed_together
from benchmarks.rows import Row, Size, time_row
from moireaug import Scene, capture, expose


def panels(size: Size) -> Iterator[Row]:
    """Yield what a panel's black matrix costs the exposure, beside stripes without one; and a scene
    without a lattice."""
    images, default = size.images(), Scene.preset("screen_photo")
    plain, scenes = black_matrices(size.lit)
    calls = {"plain": running(expose, plain, images)}
    for name, scene in scenes.items():
        calls[name] = running(expose, scene, images)
    times = timed_together(calls, size.repeats)
    for name, scene in scenes.items():
        plan = scene.plan((size.side, size.side))
        what = f"{name}: {plan.exposure}, {len(plan.harmonics)} harmonics"
        yield time_row(what, times[name], "rgb_stripe, lit 1", times["plain"], bar=1.3)
    calls = {
        "default": running(capture, default, images),
        "even": running(capture, without_lattice(), images),
    }
    times = timed_together(calls, size.repeats)
    yield time_row(
        "capture without any lattice", times["even"], "the default scene", times["default"]
    )


def black_matrices(lit: Iterable[float]) -> tuple[Scene, dict[str, Scene]]:
    """Return the default scene with stripes that are lit all over, and, by the names of their rows,
    scenes whose subpixels are lit in part, the same along both axes."""
    default = Scene.preset("screen_photo")
    whole = replace(default.panel, layout="rgb_stripe", lit=1.0, lit_x=1.0, lit_y=1.0)
    scenes = {}
    for layout in ("rgb_stripe", "pentile"):
        for share in lit:
            panel = replace(whole, layout=layout, lit=share)
            scenes[f"expose, {layout}, lit {share:g}"] = replace(default, panel=panel)
    return replace(default, panel=whole), scenes


def without_lattice() -> Scene:
    """Return the default scene with pixels that shine evenly, right up to the next."""
    default = Scene.preset("screen_photo")
    panel = replace(default.panel, layout="even", lit=1.0, lit_x=1.0, lit_y=1.0)
    return replace(default, panel=panel, sensor=replace(default.sensor, cfa="none"))


def running(stage: Callable, scene: Scene, images: Tensor) -> Callable[[], Tensor]:
    """Return `expose` or `capture` of the images, in a shot that is drawn and planned once."""
    shot = scene.sample(len(images), tuple(images.shape[-2:]), torch.Generator().manual_seed(0))
    return lambda: stage(images, shot)
