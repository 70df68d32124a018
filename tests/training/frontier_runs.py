"""Folders of runs as the frontier reads them, written without training."""

import json

from moireaug import Scene
from moireaug.evaluation.suites.scenes import OWN_SCENE_ROW, other_scenes

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
):  # fmt: skip
    """A finished run as fit.py leaves it, and its re-attack.

    `start` and `plain` are the seconds of the start and of the baseline's own training.
    """
    folder = root / recipe / f"seed{seed}"
    init = "random" if recipe == "clean" else init
    where = Scene.preset(scene).to_dict()
    train = {"seconds": seconds, "images_per_second": 600.0, "passes": 2.5}
    train |= {"init": init, "collapsed_at": collapsed}
    started = init == "clean"
    baseline = None
    if recipe not in ("clean", "baseline"):
        baseline = {"recipe": "baseline", "train": {"seconds": plain, "init": init}}
    config = {
        "adversary": {"eps": eps},
        "train": {"epochs": 12, "length": length, "weight_decay": decay},
        "data": {"name": data, "size": size, "root": at},
        "reattack": {"n": 480, "steps": 20, "seed": 1234},
    }
    metrics = {"recipe": recipe, "seed": seed, "data": data, "model": "small_resnet"}
    metrics |= {"train": train, "config": config, "baseline": baseline, "environment": device}
    metrics |= {"start": {"recipe": "clean", "train": {"seconds": start}} if started else None}
    metrics |= {"scene_name": scene, "scene": where}
    write(folder, metrics)
    if attacked:
        rows = [cell(f"eps_{e}", "worst", w, n) for e, w in zip((4, 8), worst, strict=True)]
        rows += [
            cell("eps_4", "clean", 0.9, n),
            cell("eps_4", "pgd", 0.4, n),
            cell("eps_4", "moire", 0.7, n),
        ]
        photos = [cell(OWN_SCENE_ROW, "moire", 0.7, n), cell(OWN_SCENE_ROW, "no_moire", 0.8, n)]
        photos += [
            cell(name, "moire", unseen + 0.2 * (i % 2), n)
            for i, name in enumerate(other_scenes(SCENE))
        ]
        again = {"n": n, "steps": steps, "scene": where, "config": config, "trust": list(trust),
                 "tables": {"worst_case": rows, "unseen": photos}}  # fmt: skip
        write(folder / "reattack" / f"{scene}-n{n}-steps{steps}" / "recipes", again)
    return folder


def write(folder, metrics):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "metrics.json").write_text(json.dumps(metrics))


def metrics_in(folder):
    return json.loads((folder / "metrics.json").read_text())


def attack_of(folder):
    """The folder of a run's one re-attack."""
    (path,) = folder.glob("reattack/*/recipes")
    return path
