"""Finished runs and their re-attacks, read from a folder of runs: a point for each run, or a sentence why not."""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

from moireaug.evaluation.recipes import OWN
from moireaug.evaluation.words import Metrics
from training.runs import read_metrics

STEPS = 50  # of the re-attack that a run without one is advised to have
_WHERE = ("root", "workers", "download")  # settings of the data that no image depends on


@dataclass(frozen=True)
class Point:
    """One run, attacked again in its own scene.

    Args:
        clean, natural, ..., pgd_4: accuracies in [0, 1], all on the same n test images. natural: moiré without noise in
            the scene of the training; unseen_mean, unseen_worst: over the other presets; worst_4, worst_8: each image
            at its worst attacker, at 4/255 and 8/255; pgd_4: pixels, no camera.
        seconds: of this run's own training. start_seconds: of the training that made the weights it began with; 0 where
            it began with random ones. clean_seconds: of recipe `clean` with the same seed and settings.
        passes: forward and backward, an image, of its own training. images_per_second: of the same.
        collapsed: whether catastrophic overfitting was seen while it was trained.
    """

    recipe: str
    seed: int
    n: int
    clean: float
    natural: float
    unseen_mean: float
    unseen_worst: float
    worst_4: float
    worst_8: float
    pgd_4: float
    seconds: float
    start_seconds: float
    clean_seconds: float
    passes: float
    images_per_second: float
    collapsed: bool

    @property
    def total_seconds(self) -> float:
        return self.seconds + self.start_seconds


class Found(NamedTuple):
    """What a folder of runs holds: its points; what they share; commands that attack the other runs; and warnings."""

    points: list[Point]
    shared: dict[str, Any]
    commands: list[str]
    warnings: list[str]


def read(root: Path) -> Found:
    """Every finished run of `root`/<recipe>/seed<k>/ that suite `recipes` has attacked in its own scene.

    Raises:
        ValueError: no run, none attacked, runs or re-attacks that do not compare, or a file that lacks something.
    """
    root, others = _group(root)
    trained = {folder: m for folder in _seeds(root) if (m := read_metrics(folder)) and "train" in m}
    if not trained:
        raise ValueError(
            f"no finished run in {root}: it must hold <recipe>/seed<k>/metrics.json, as training/fit.py writes them. "
            "Pass the folder that runs= named, or one of other data or models in it."
        )
    try:
        settings = _same({folder: _settings(m) for folder, m in trained.items()}, "runs")
        attacked = {folder: again for folder, m in trained.items() if (again := _again(folder, m))}
        protocol = _same({folder: _protocol(again) for folder, again in attacked.items()}, "re-attacks")
        commands = [_command(f, m, protocol) for f, m in trained.items() if f not in attacked]
        if not attacked:
            raise ValueError(
                "\n  ".join([f"no run in {root} was attacked by suite=recipes in its own scene. Run:", *commands])
            )
        points = [_point(folder, trained, again) for folder, again in attacked.items()]
        warnings = _warnings(trained, attacked) + others
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(
            f"a metrics.json in {root} lacks {error}: another version of this project wrote it. Train and attack again."
        ) from error
    shared = {"data": _data(trained.values()), "model": settings["model"], "scene": settings["scene"]}
    return Found(points, shared | {k.removeprefix("reattack."): v for k, v in protocol.items()}, commands, warnings)


def _seeds(root: Path) -> list[Path]:
    """The folders <recipe>/seed<k> of a folder that hold a finished run."""
    return sorted(p.parent for p in root.glob("*/*/metrics.json") if re.fullmatch(r"seed-?\d+", p.parent.name))


def _group(root: Path) -> tuple[Path, list[str]]:
    """The folder whose runs are read, and a note on those of other data or models, which do not compare with them.

    Raises:
        ValueError: nothing but groups of runs, of which one must be chosen.
    """
    groups = [path for path in sorted(root.glob("*")) if path.is_dir() and _seeds(path)]
    if not groups:
        return root, []
    named = ", ".join(shlex.quote(str(path)) for path in groups)
    if _seeds(root):
        return root, [f"Runs of other data or models are left out; for a table of these pass {named}."]
    if len(groups) == 1:
        return groups[0], []
    raise ValueError(f"{root} holds runs of several data sets or models, which do not compare: pass one of {named}.")


def _data(metrics: Iterable[Metrics]) -> str:
    """The data set's name; a folder goes by its own, where all runs have the same."""
    sets = [m["config"]["data"] for m in metrics]
    own = {Path(data["root"]).resolve().name for data in sets if data["name"] == "folder"}
    return own.pop() if len(own) == 1 else sets[0]["name"]


def _settings(m: Metrics) -> dict[str, Any]:
    data = {f"data.{k}": v for k, v in m["config"]["data"].items() if k not in _WHERE}
    parts = {f"scene.{k}": v for k, v in m["scene"].items()}
    return {"model": m["model"], "scene": m["scene_name"]} | data | parts


def _protocol(again: Metrics) -> dict[str, Any]:
    return {f"reattack.{k}": v for k, v in _attack(again).items()}


def _attack(again: Metrics) -> dict[str, Any]:
    return {"n": again["n"], "steps": again["steps"], "seed": again["config"]["reattack"]["seed"]}


def _same(every: Mapping[Path, Mapping[str, Any]], what: str) -> dict[str, Any]:
    """What all of them share; empty where there are none.

    Raises:
        ValueError: one differs from most; it is named, with what differs.
    """
    shared: dict[str, Any] = {}
    for key in next(iter(every.values()), ()):
        values = {folder: own.get(key) for folder, own in every.items()}
        usual = Counter(map(repr, values.values())).most_common(1)[0][0]
        odd = next((folder for folder, value in values.items() if repr(value) != usual), None)
        if odd:
            raise ValueError(
                f"{what} with different {key} do not compare: {odd} has {values[odd]!r}, most others have {usual}. "
                "Make it again with the same, or move it to another folder."
            )
        shared[key] = next(iter(values.values()))
    return shared


def _again(folder: Path, m: Metrics) -> Metrics | None:
    """The re-attack of a run in its own scene."""
    found = (read_metrics(path) for path in sorted(folder.glob("reattack/*/recipes")))
    return next((again for again in found if again and again["scene"] == m["scene"]), None)


def _command(folder: Path, m: Metrics, protocol: Mapping[str, Any]) -> str:
    """What attacks a run as the others were attacked."""
    wanted = protocol or {"reattack.steps": STEPS}
    own = {f"reattack.{k}": v for k, v in m["config"]["reattack"].items()}
    more = "".join(f" {k}={v}" for k, v in wanted.items() if own.get(k) != v)
    return f"python training/reattack.py run={shlex.quote(str(folder))} suite=recipes{more}"


def _point(folder: Path, trained: Mapping[Path, Metrics], again: Metrics) -> Point:
    m, rate = trained[folder], _accuracies(again)
    natural = {row: value for (row, column), value in rate.items() if column == "moiré, δ = 0" and row[0] != "ε"}
    train, own = m["train"], natural.pop(OWN)
    plain = _clean_seconds(folder, trained)
    return Point(
        m["recipe"], m["seed"], again["n"], rate["ε = 4", "clean"], own, fmean(natural.values()), min(natural.values()),
        rate["ε = 4", "worst case"], rate["ε = 8", "worst case"], rate["ε = 4", "PGD on pixels"],
        train["seconds"], plain if train["init"] == "clean" else 0.0, plain, train["passes"],
        train["images_per_second"], train.get("collapsed_at") is not None,
    )  # fmt: skip


def _accuracies(again: Metrics) -> dict[tuple[str, str], float]:
    """(row, column) to accuracy, of both tables, whose rows have different names."""
    return {(r["row"], r["column"]): r["accuracy"] for t in ("worst_case", "unseen") for r in again["tables"][t]}


def _clean_seconds(folder: Path, trained: Mapping[Path, Metrics]) -> float:
    """Training time of recipe `clean` with the same seed: as the run kept it, else as the clean run says."""
    m, twin = trained[folder], folder.parent.parent / "clean" / folder.name
    source = m if m["recipe"] == "clean" else m.get("baseline") or trained.get(twin)
    if not source:
        raise ValueError(
            f"{folder} does not say how long its clean baseline was trained, and there is no finished run in {twin}: "
            f"train recipe clean with seed={m['seed']} and the same settings."
        )
    return source["train"]["seconds"]


def _warnings(trained: Mapping[Path, Metrics], attacked: Mapping[Path, Metrics]) -> list[str]:
    """What a reader must know before he believes the figures."""
    machines = {_machine(trained[folder]["environment"]) for folder in attacked}
    said = [f"The runs were trained on different machines ({'; '.join(sorted(machines))}): their times do not compare."]
    found = said if len(machines) > 1 else []
    for folder, again in attacked.items():
        failed = [check["name"] for check in again.get("trust") or [] if check["verdict"] == "fail"]
        found += [f"Checks of the attack failed on {folder}: {'; '.join(failed)}."] if failed else []
    return found


def _machine(environment: Mapping[str, Any]) -> str:
    device = environment["device"]
    return f"{environment['cpu']}, {environment['threads']} threads" if device == "cpu" else device
