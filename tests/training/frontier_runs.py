"""Folders of runs as the frontier reads them, written without training."""

import json
from dataclasses import replace

from moireaug import Scene
from moireaug.evaluation import SuiteConfig
from moireaug.evaluation.suites.scenes import OWN_SCENE_ROW, other_scenes
from training.config.schema import Config
from training.runs.metrics import PlainMetrics, RunMetrics, SuiteMetrics, TrainCost
from training.runs.run import Run

SCENE = Scene.preset("screen_photo")
ENVIRONMENT = {"device": "cpu", "cpu": "a slow one", "threads": 2}


def cell(row, column, accuracy, n):
    """A cell of which the first images are right."""
    right = round(accuracy * n)
    return {"row": row, "column": column, "outcomes": "1" * right + "0" * (n - right)}


def put(
    root, recipe, seed, *, worst=(0.2, 0.1), seconds=10.0, start=10.0, plain=20.0, init="clean",
    unseen=0.6, attacked=True, n=200, steps=50, collapsed=None, scene="screen_photo", data="signs",
    at=None, size=48, device=ENVIRONMENT, trust=(), eps=0.02, decay=None, length=1.0,
    weights=None, bound="codes",
):  # fmt: skip
    """A finished run as fit.py leaves it, and its re-attack.

    `start` and `plain` are the seconds of the start and of the baseline's own training.
    """
    folder = root / recipe / f"seed{seed}"
    init = "random" if recipe == "clean" else init
    where = Scene.preset(scene).to_dict()
    config = Run(Config(recipe=recipe, seed=seed, model="small_resnet")).settings
    config["adversary"]["eps"], config["weights"] = eps, weights
    config["train"] |= {"epochs": 12, "length": length, "weight_decay": decay, "init": init}
    config["data"] |= {"name": data, "size": size, "root": at}
    config["reattack"] |= {"n": 480, "steps": 20, "seed": 1234}
    names = {"recipe": recipe, "seed": seed, "data": data, "model": "small_resnet"}
    facts = names | {"scene_name": scene, "scene": where, "config": config, "environment": device}
    facts |= {"plan": "", "fingerprint": "", "command": ""}
    own_start = baseline = None
    if init == "clean":
        own_start = PlainMetrics(**names | {"recipe": "clean"}, train=cost(start, "random"))
    if recipe not in ("clean", "baseline"):
        baseline = PlainMetrics(**names | {"recipe": "baseline"}, train=cost(plain, init))
    train = replace(cost(seconds, init), collapsed_at=collapsed)
    gain = {"gain": {}, "gain_interval": {}}
    RunMetrics(**facts, train=train, start=own_start, baseline=baseline, **gain).write(made(folder))
    if attacked:
        rows = [cell(f"eps_{e}", "worst", w, n) for e, w in zip((4, 8), worst, strict=True)]
        others = {"clean": 0.9, "pgd": 0.4, "moire": 0.7}
        rows += [cell("eps_4", column, accuracy, n) for column, accuracy in others.items()]
        photos = [cell(OWN_SCENE_ROW, "moire", 0.7, n), cell(OWN_SCENE_ROW, "no_moire", 0.8, n)]
        for i, name in enumerate(other_scenes(SuiteConfig(scene=SCENE))):
            photos.append(cell(name, "moire", unseen + 0.2 * (i % 2), n))
        facts |= {"suite": "recipes", "n": n, "steps": steps, "eps": 0.02, "bound": bound}
        facts["trust"] = list(trust)
        out = folder / "reattack" / f"{scene}-n{n}-steps{steps}" / "recipes"
        SuiteMetrics(**facts, tables={"worst_case": rows, "unseen": photos}).write(made(out))
    return folder


def cost(seconds, init):
    """The cost of a training of one epoch."""
    facts = {"init": init, "passes": 2.5, "images_per_second": 600.0, "collapsed_at": None}
    facts |= {"epochs": 1, "total_epochs": 1, "best_epoch": 0, "history": [{"seconds": seconds}]}
    return TrainCost(
        **facts, **dict.fromkeys(("seconds", "wall_seconds", "total_seconds"), seconds)
    )


def made(folder):
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def write(folder, metrics):
    (made(folder) / "metrics.json").write_text(json.dumps(metrics))


def metrics_in(folder):
    return json.loads((folder / "metrics.json").read_text())


def attack_of(folder):
    """The folder of a run's one re-attack."""
    (path,) = folder.glob("reattack/*/recipes")
    return path
