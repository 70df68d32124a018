"""What a step of training through the camera costs on a GPU."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from hydra import initialize

from benchmarks import training_steps

ATTACKED_SHARE = "adversary.share=0.625"  # of the batch that is attacked, in both
RECIPES = {
    "plain": ["recipe=clean"],
    "RandomMoire on the batch": ["recipe=moire_aug", "adversary.natural=1.0"],
    "pgd_at": ["recipe=pgd_at", ATTACKED_SHARE, "adversary.natural=0"],
    "moire_at": ["recipe=moire_at", ATTACKED_SHARE],
}
# a step with as many passes of the network, and no camera
WITHOUT_CAMERA = {"RandomMoire on the batch": "plain", "moire_at": "pgd_at"}


def steps(
    models: tuple[str, ...], batch: int, side: int, device: torch.device
) -> dict[str, Callable[[], None]]:
    """Return a step of training in bfloat16 for each model and recipe."""
    calls = {}
    with initialize(version_base="1.3", config_path=None), torch.enable_grad():
        for model in models:
            for name, recipe in RECIPES.items():
                cfg = training_steps.configure(
                    *recipe, f"model={model}", f"data.size={side}", "trainer.precision=bf16-mixed"
                )
                calls[f"{model}, {name}"] = training_steps.step(cfg, batch, side, device)
    return calls


def add_camera_shares(rows: list[dict[str, Any]]) -> None:
    """Add the camera's share of each step's time to its row: what the step takes more than one with
    as many passes of the network."""
    medians = {row["what"]: row["seconds"]["median"] for row in rows}
    for row in rows:
        model, name = row["what"].split(", ")
        without = WITHOUT_CAMERA.get(name)
        row["camera_share"] = None
        if without is not None:
            row["camera_share"] = 1 - medians[f"{model}, {without}"] / medians[row["what"]]
