"""The metrics and pictures of a run to report."""

import numpy as np
import pytest

from moireaug.evaluation.statistics import wilson

N, COUNTED = 200, 180
LADDER_ROWS = {
    "clean": 0,
    "no_moire": 0,
    "moire": 0,
    "ma_2": 2 / 255,
    "ma_4": 4 / 255,
    "ma_8": 8 / 255,
    "ma_4_targeted": 4 / 255,
    "pgd_4": 4 / 255,
}


def rows(accuracies, fooled):
    found = []
    for (name, eps), accuracy, success in zip(LADDER_ROWS.items(), accuracies, fooled, strict=True):
        row = {
            "name": name,
            "eps": eps,
            "steps": 20 if eps else 0,
            "control": not eps,
            "targeted": name.endswith("targeted"),
            "accuracy": accuracy,
            "accuracy_interval": list(wilson(round(accuracy * N), N)),
            "success": success,
            "success_interval": list(wilson(round(success * COUNTED), COUNTED)),
            "n": N,
            "counted": COUNTED,
            "undecided": 0,
            "seconds": 1.5,
        }
        if eps:
            row |= {"psnr": 38.2, "ssim": 0.987, "ciede2000": 1.2, "largest": 12 / 255}
        found.append(row)
    return found


def run(recipe, accuracies, fooled, seconds):
    history = [
        {"epoch": i, "loss": 2.0 - i, "clean": 0.4 + 0.2 * i, "perturbed": 0.3, "seconds": 9.0}
        for i in range(2)
    ]
    return {
        "recipe": recipe,
        "seed": 0,
        "data": "signs",
        "model": "small_resnet",
        "clean_accuracy": accuracies[0],
        "train": {
            "seconds": seconds,
            "epochs": 2,
            "best_epoch": 1,
            "images_per_second": 100.0,
            "passes": 3.25,
            "history": history,
            "init": "clean",
        },
        "baseline": None,
        "start": None,
        "reattack": rows(accuracies, fooled),
    }


@pytest.fixture
def metrics():
    """A run, plain training of as many epochs, and the start of both."""
    ours = run(
        "moire_at",
        (0.9, 0.9, 0.9, 0.8, 0.76, 0.5, 0.8, 0.6),
        (0, 0.02, 0.03, 0.1, 0.18, 0.5, 0.1, 0.3),
        210.0,
    )
    theirs = run(
        "baseline",
        (0.95, 0.8, 0.5, 0.2, 0.08, 0, 0.2, 0),
        (0, 0.2, 0.46, 0.8, 0.92, 1, 0.6, 1),
        70.0,
    )
    start = {"recipe": "clean", "train": {"seconds": 60.0, "epochs": 2, "init": "random"}}
    for side in (ours, theirs):
        side["train"] |= {"total_seconds": side["train"]["seconds"] + 60.0, "total_epochs": 4}
    gains = {}
    for own, plain in zip(ours["reattack"], theirs["reattack"], strict=True):
        gains[own["name"]] = own["accuracy"] - plain["accuracy"]
    return ours | {
        "baseline": theirs,
        "start": start,
        "gain": gains,
        "gain_interval": {name: [gain - 0.06, gain + 0.06] for name, gain in gains.items()},
        "time": {"data": 1.0, "train": 210.0, "re-attack": 60.0, "pictures": 0.5},
        "scene": {"panel": {"scale": [1.0, 2.0]}},
        "plan": "12 effects are computed, in this order",
        "scene_name": "screen_photo",
        "config": {"data": {"name": "signs", "root": None}, "empty": {}},
        "environment": {"python": "3.11.7", "threads": 2},
        "command": "python training/fit.py recipe=moire_at",
    }


@pytest.fixture
def pictures():
    def image(side):
        return np.random.default_rng(side).integers(0, 256, (side, side, 3), dtype=np.uint8)

    cell = {
        "title": "clean image",
        "image": image(32),
        "predictions": [("moire_at", "stop", True), ("baseline", "go", False)],
    }
    return [{"label": "stop", "cells": [cell, {"title": "noise, × 8", "image": image(299)}]}]
