"""The report of a calibration: a page, and a table of its crops."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import torch

from moireaug.scenes import Scene
from training.calibration.compare import StatisticRow, mean_distance, number_text, span_text
from training.calibration.crops import Crops
from training.calibration.fit import FittedScene
from training.report.page import environment, middle_of, uri
from training.system import machine

TEMPLATE = Path(__file__).with_name("report.html.j2")
MAX_CROPS = 6  # of the page


def crop_table(
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


def example_blocks(crops: Crops, simulated: torch.Tensor | None, name: str) -> list[dict[str, Any]]:
    """Return the pictures of the page: a crop of each of the first pictures, side by side."""
    examples = []
    for index, label in list(enumerate(crops.names))[:MAX_CROPS]:
        row = int((crops.picture == index).nonzero()[0])
        sides = {"real photo": crops.photos, name: simulated, "original": crops.originals}
        cells = []
        for heading, pictures in sides.items():
            if pictures is not None:
                middle = middle_of(pictures[row]).permute(1, 2, 0).contiguous()
                cells.append({"title": heading, "image": middle.numpy()})
        examples.append({"label": label, "cells": cells})
    return examples


def page(
    table: Sequence[StatisticRow],
    crops: Crops,
    scene: Scene,
    name: str,
    plot: bytes,
    examples: list[dict[str, Any]],
    fitted: FittedScene | None,
) -> str:
    """Return the report as a self-contained page."""
    paired = crops.originals is not None
    rows = []
    for row in table:
        distance = "" if row.distance is None else number_text(row.distance)
        rows.append(
            {
                "title": row.statistic.title,
                "unit": row.statistic.unit,
                "real": span_text(row.real),
                "simulated": span_text(row.simulated),
                "apart": distance,
            }
        )
    n = f"{len(crops.photos)} crops of {crops.photos.shape[-1]} px from {len(crops.names)} photos"
    lead = f"{n}, without their originals: nothing is simulated."
    title = "Real photos of screens, measured"
    if paired:
        title = f"{name} beside real photos of screens"
        distance = f"{mean_distance(table):.3f} (0.7 is a factor of two)"
        lead = f"{n}. Mean distance of the statistics: {distance}."
    run: dict[str, Any] = dict.fromkeys(("environment", "config", "scene"))
    run["command"] = machine.command()
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
        paired=paired,
        fit=None if fitted is None else fitted.report_values(),
        examples=examples,
        alt=f"Plot of {len(table)} statistics: medians and spans, as in the table below",
        metrics=run,
    )
