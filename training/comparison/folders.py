"""The runs of a folder and their re-attacks, as metrics: which of them are compared."""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from training.comparison.comparable import image_settings
from training.runs.metrics import RunMetrics, SuiteMetrics
from training.system.files import read_metrics


def run_folders(root: Path) -> list[Path]:
    """Return the folders <recipe>/seed<k> of a folder that hold a finished run."""
    folders = sorted(path.parent for path in root.glob("*/*/metrics.json"))
    return [folder for folder in folders if re.fullmatch(r"seed\d+", folder.name)]


def read_classifiers(root: Path) -> dict[Path, RunMetrics]:
    """Return the metrics of a folder's finished classifiers; a demoiréing network has no adversary
    and no place in the table.

    Raises:
        ValueError: another version wrote one of them.
    """
    classifiers = {}
    for folder in run_folders(root):
        is_classifier = "adversary" in (read_metrics(folder) or {}).get("config", {})
        metrics = RunMetrics.read(folder) if is_classifier else None
        if metrics:
            classifiers[folder] = metrics
    return classifiers


def group_in(root: Path) -> tuple[Path, list[str]]:
    """Return the folder whose runs are read, and a note on those of other data or models, which
    cannot be compared with them.

    Raises:
        ValueError: there are only groups of runs, of which one must be chosen.
    """
    groups = [path for path in sorted(root.glob("*")) if path.is_dir() and read_classifiers(path)]
    if not groups:
        return root, []
    names = ", ".join(shlex.quote(str(path)) for path in groups)
    if read_classifiers(root):
        note = f"Runs of other data or models are left out; for a table of these pass {names}."
        return root, [note]
    if len(groups) == 1:
        return groups[0], []
    raise ValueError(
        f"{root} holds runs of several data sets or models, which cannot be compared: pass "
        f"one of {names}."
    )


def read_attacks(folder: Path, metrics: RunMetrics) -> list[SuiteMetrics]:
    """Read the re-attacks of a run's final weights in its own scene, on its own images.

    Args:
        folder: folder of the run.
        metrics: metrics of the run.
    """
    attacks = []
    for path in sorted(folder.glob("reattack/*/recipes")):
        attack = SuiteMetrics.read(path)
        if not attack or attack.scene != metrics.scene:
            continue
        if image_settings(attack) != image_settings(metrics):
            continue
        # the weights of an unfinished run can be attacked, too
        if metrics.identity in (None, attack.identity):
            attacks.append(attack)
    return attacks


def choose_attacks(
    attacks_by_run: Mapping[Path, list[SuiteMetrics]],
) -> dict[Path, SuiteMetrics]:
    """Choose a re-attack of each run that has any: one of the size that most runs have; of several
    that as many have, the one with the most images, then the most steps."""
    runs_with: Counter[tuple[int, int]] = Counter()
    for attacks in attacks_by_run.values():
        runs_with.update({_size(attack) for attack in attacks})
    chosen = {}
    for folder, attacks in attacks_by_run.items():
        if attacks:
            chosen[folder] = max(
                attacks, key=lambda attack: (runs_with[_size(attack)], _size(attack))
            )
    return chosen


def _size(attack: SuiteMetrics) -> tuple[int, int]:
    return attack.n, attack.steps
