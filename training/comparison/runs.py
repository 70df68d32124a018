"""The runs of a folder and their re-attacks, as metrics."""

import shlex
from pathlib import Path

from training.comparison.comparable import image_settings
from training.runs.metrics import RunMetrics, SuiteMetrics
from training.system.files import read_metrics


def read_classifiers(root: Path) -> tuple[dict[Path, RunMetrics], list[str]]:
    """Return the metrics of the finished classifiers in `root`/<recipe>/seed<k>/, and a sentence on
    each that is damaged. A demoiréing network has no adversary and no place in the table."""
    classifiers, warnings = {}, []
    for path in sorted(root.glob("*/seed*/metrics.json")):
        folder = path.parent
        if not folder.name.removeprefix("seed").isdecimal():  # set aside by fit.py
            continue
        values = read_metrics(folder)
        if values is None:
            warnings.append(
                f"{path} is damaged, and the run left out: its command, given again, writes it "
                "anew."
            )
        elif "adversary" in values.get("config", {}) and (metrics := RunMetrics.read(folder)):
            classifiers[folder] = metrics
    if classifiers:
        return classifiers, warnings
    problem = (
        f"no finished run in {root}: it must hold <recipe>/seed<k>/metrics.json, as "
        "training/fit.py writes them."
    )
    groups = {path.parents[2] for path in root.glob("*/*/seed*/metrics.json")}
    if groups:
        names = ", ".join(shlex.quote(str(path)) for path in sorted(groups))
        problem += f" A table is of one data set and model: pass one of {names}."
    raise ValueError(problem)


def read_attack(folder: Path, metrics: RunMetrics) -> SuiteMetrics | None:
    """Read the largest re-attack, by images and then steps, of a run's final weights in its own
    scene, on its own images; None where there is none."""
    attacks = []
    for path in sorted(folder.glob("reattack/*/recipes")):
        attack = SuiteMetrics.read(path)
        if not attack or attack.scene != metrics.scene:
            continue
        # the weights of an unfinished run can be attacked, too
        is_of_these_weights = metrics.identity in (None, attack.identity)
        if is_of_these_weights and image_settings(attack) == image_settings(metrics):
            attacks.append(attack)
    return max(attacks, key=lambda attack: (attack.n, attack.steps), default=None)
