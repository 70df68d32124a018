"""The report of a calibration: a page, and a table of its crops."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import torch

from moireaug.evaluation.report.page import environment, uri
from moireaug.scenes import Scene
from training.calibration.compare import Line, distance, number, shown
from training.calibration.fit import Fitted
from training.calibration.pairs import Crops

TEMPLATE = Path(__file__).with_name("report.html.j2")
CROP_SIDE = 300  # pixels of a crop that the page shows
MAX_CROPS = 6  # crops that it shows


def by_crop(
    crops: Crops, real: list[dict[str, float]], simulated: list[dict[str, float]] | None
) -> pd.DataFrame:
    """Return one row per crop, real ones first."""
    tables = []
    for kind, rows in (("real", real), ("simulated", simulated)):
        if rows is not None:
            table = pd.DataFrame(rows)
            table.insert(0, "picture", [crops.names[int(i)] for i in crops.picture])
            table.insert(0, "photos", kind)
            tables.append(table)
    return pd.concat(tables)


def blocks(crops: Crops, simulated: torch.Tensor | None, name: str) -> list[dict[str, Any]]:
    """Return the pictures of the page: a crop of each of the first pictures, side by side."""
    found = []
    for index, label in list(enumerate(crops.names))[:MAX_CROPS]:
        row = int((crops.picture == index).nonzero()[0])
        sides = {"real photo": crops.photos, name: simulated, "original": crops.originals}
        cells = []
        for title, pictures in sides.items():
            if pictures is not None:
                cells.append({"title": title, "image": _middle(pictures[row])})
        found.append({"label": label, "cells": cells})
    return found


def _middle(picture: torch.Tensor) -> Any:
    top, left = (max(0, (length - CROP_SIDE) // 2) for length in picture.shape[1:])
    middle = picture[:, top : top + CROP_SIDE, left : left + CROP_SIDE]
    return middle.permute(1, 2, 0).contiguous().numpy()


def page(
    found: Sequence[Line],
    crops: Crops,
    scene: Scene,
    name: str,
    plot: bytes,
    examples: list[dict[str, Any]],
    fitted: Fitted | None,
) -> str:
    """Return the report as a self-contained page."""
    paired = crops.originals is not None
    rows = []
    for line in found:
        apart = "" if line.distance is None else number(line.distance)
        rows.append(
            {
                "title": line.statistic.title,
                "unit": line.statistic.unit,
                "real": shown(line.real),
                "simulated": shown(line.simulated),
                "apart": apart,
            }
        )
    n = f"{len(crops.photos)} crops of {crops.photos.shape[-1]} px from {len(crops.names)} photos"
    lead = f"{n}, without their originals: nothing is simulated."
    title = "Real photos of screens, measured"
    if paired:
        title = f"{name} beside real photos of screens"
        apart = f"{distance(found):.3f} (0.7 is a factor of two)"
        lead = f"{n}. Mean distance of the statistics: {apart}."
    run: dict[str, Any] = dict.fromkeys(("environment", "config", "scene"))
    run["command"] = shlex.join(["python", *sys.argv])
    run["plan"] = str(scene.plan()) if paired else None
    run["scene_name"] = name
    template = environment().overlay(autoescape=True).from_string(TEMPLATE.read_text("utf-8"))
    return template.render(
        title=title,
        lead=lead,
        facts={"photos": len(crops.names), "crops": len(crops.photos)},
        plot=uri(plot, "image/png"),
        rows=rows,
        scene=name,
        simulated=paired,
        paired=paired,
        fit=None if fitted is None else fitted.view(),
        examples=examples,
        alt=f"Plot of {len(found)} statistics: medians and spans, as in the table below",
        metrics=run,
    )
