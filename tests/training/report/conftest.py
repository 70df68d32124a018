"""The metrics and pictures of a run to report."""

from dataclasses import replace

import numpy as np
import pytest

from moireaug.evaluation.statistics import wilson
from tests.training import frontier_runs
from training.runs.metrics import PlainMetrics, RunMetrics, SuiteMetrics

N, COUNTED = 200, 180
LADDER_ROWS = {"clean": 0, "no_moire": 0, "moire": 0, "ma_2": 2, "ma_4": 4, "ma_8": 8}
LADDER_ROWS |= {"ma_4_targeted": 4, "pgd_4": 4}  # eps * 255


def rows(accuracies, fooled):
    found = []
    for (name, eps), accuracy, success in zip(LADDER_ROWS.items(), accuracies, fooled, strict=True):
        row = {
            "name": name,
            "eps": eps / 255,
            "bound": "codes" if eps else "",
            "steps": 20 if eps else 0,
            "control": not eps,
        }
        row |= {"headline": name == "ma_4", "targeted": name.endswith("targeted")}
        row |= {"accuracy": accuracy, "success": success}
        row["accuracy_interval"] = list(wilson(round(accuracy * N), N))
        row["success_interval"] = list(wilson(round(success * COUNTED), COUNTED))
        row |= {"n": N, "counted": COUNTED, "undecided": 0, "seconds": 1.5}
        if eps:
            row |= {"psnr": 38.2, "ssim": 0.987, "ciede2000": 1.2, "largest": 12 / 255}
        found.append(row)
    return found


def cost(seconds):
    """The cost of a training of two epochs, with a start of two epochs and 60 s."""
    history = [
        {"epoch": i, "loss": 2.0 - i, "clean": 0.4 + 0.2 * i, "perturbed": 0.3, "seconds": 9.0}
        for i in range(2)
    ]
    facts = {"passes": 3.25, "images_per_second": 100.0, "history": history, "best_epoch": 1}
    totals = {"epochs": 2, "total_epochs": 4, "total_seconds": seconds + 60.0}
    return replace(frontier_runs.cost(seconds, "clean"), **facts, **totals)


def run_metrics():
    """A run, and plain training of as many epochs."""
    names = {"seed": 0, "data": "signs", "model": "small_resnet"}
    accuracies = (0.9, 0.9, 0.9, 0.8, 0.76, 0.5, 0.8, 0.6)
    ours = rows(accuracies, (0, 0.02, 0.03, 0.1, 0.18, 0.5, 0.1, 0.3))
    theirs = rows((0.95, 0.8, 0.5, 0.2, 0.08, 0, 0.2, 0), (0, 0.2, 0.46, 0.8, 0.92, 1, 0.6, 1))
    gains = {}
    for own, plain in zip(ours, theirs, strict=True):
        gains[own["name"]] = own["accuracy"] - plain["accuracy"]
    beside = {"train": cost(70.0), "clean_accuracy": 0.95, "reattack": theirs}
    return RunMetrics(
        **names,
        recipe="moire_at",
        scene_name="screen_photo",
        scene={"panel": {"scale": [1.0, 2.0]}},
        plan="12 effects are computed, in this order",
        config={"data": {"name": "signs", "root": None}, "empty": {}},
        fingerprint="",
        environment={"python": "3.11.7", "threads": 2},
        command="python training/fit.py recipe=moire_at",
        time={"data": 1.0, "train": 210.0, "re-attack": 60.0, "pictures": 0.5},
        train=cost(210.0),
        clean_accuracy=0.9,
        reattack=ours,
        start=None,
        baseline=PlainMetrics(**names, recipe="baseline", **beside),
        gain=gains,
        gain_interval={name: [gain - 0.06, gain + 0.06] for name, gain in gains.items()},
    )


@pytest.fixture
def metrics():
    return run_metrics()


@pytest.fixture
def alone(metrics):
    """The same without a baseline."""
    return replace(metrics, baseline=None, gain={}, gain_interval={})


def suite_metrics(**given):
    """The metrics of a suite, without its tables."""
    facts = dict.fromkeys(("data", "scene_name", "plan", "fingerprint", "command"), "")
    facts |= {"recipe": "pretrained", "model": "m", "suite": "recipes", "seed": 0, "n": 4}
    facts |= {"scene": None, "config": {}, "environment": {}, "steps": 2, "eps": 4 / 255}
    facts["bound"] = "codes"
    return SuiteMetrics(**facts | {"tables": {}, "time": {"re-attack": 1.0}} | given)


def image(side):
    return np.random.default_rng(side).integers(0, 256, (side, side, 3), dtype=np.uint8)


def run_pictures():
    answers = [("moire_at", "stop", True), ("baseline", "go", False)]
    cell = {"title": "clean image", "image": image(32), "predictions": answers}
    return [{"label": "stop", "cells": [cell, {"title": "noise, × 8", "image": image(299)}]}]


@pytest.fixture
def pictures():
    return run_pictures()
