"""Who runs an exposure method: the engine, the reference, or an older checkout."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from benchmarks.checkouts import Checkout, plain
from moireaug import Shot, engine, expose
from moireaug.engine import program
from moireaug.engine.cpu import run
from moireaug.engine.lower.exposure import lower_exposure
from moireaug.engine.lower.exposure_records import FullView

WITHOUT = "one panel pixel"


class Run(NamedTuple):
    """A method and who runs it: what is timed, and the reading (1, planes, h, w) of the first
    image."""

    by: str
    shot: Shot
    timed: Callable[[], Any]
    reading: Callable[[], Tensor]


def runs_of(shots: dict[str, Shot], shown: Tensor, before: Checkout | None) -> dict[str, Run]:
    """Return all methods by name, those of the reference and the older checkout with a prefix that
    says so."""
    runs = {}
    for name, shot in shots.items():
        by = "reference" if program.program_of(shot.scene, shot.plan).why_not_expose else "engine"
        runs[name] = Run(
            by, shot, partial(expose, shown, shot), partial(expose, shown[:1], shot[:1])
        )
    auto = shots["auto"]
    if runs["auto"].by == "engine":
        runs[WITHOUT] = Run(
            "engine", auto, partial(one_cell, shown, auto), partial(one_cell, shown[:1], auto[:1])
        )
    spectral = {name: shot for name, shot in shots.items() if name.startswith("spectral")}
    for name, shot in spectral.items():
        timed, reading = partial(unfused, shown, shot), partial(unfused, shown[:1], shot[:1])
        runs[f"reference {name}"] = Run("reference", shot, timed, reading)
    if before:
        for name, shot in spectral.items():
            before.ask("hold", key=name, scene=plain(shot.scene), images=shown.numpy())
            timed, reading = before.call(name, "expose"), partial(first_reading, before, name)
            runs[f"before {name}"] = Run("before", shot, timed, reading)
    return runs


def unfused(shown: Tensor, shot: Shot) -> Tensor:
    with engine.reference():
        return expose(shown, shot)


def one_cell(shown: Tensor, shot: Shot) -> Tensor:
    """Return the engine's reading if each sensor pixel sees only the panel pixel in front of its
    centre."""
    whole, view = lower_exposure(shot, decoded=False)
    exposure = whole._replace(
        cell=whole.cell._replace(radius=0),
        neighbour_share=np.zeros_like(whole.neighbour_share),
    )
    if isinstance(view, FullView):  # only weights read widths, and a single cell has none
        view = view._replace(widths=np.minimum(view.widths, 0.5))
    run.fits(exposure, view)  # as every exposure does
    return run.launch_expose(shown, False, exposure, view)[0]


def first_reading(before: Checkout, name: str) -> Tensor:
    return torch.from_numpy(before.ask("result", key=name, what="first reading"))
