"""Train a classifier against the Moiré Attack, attack it again, and report gain and cost.

    python training/fit.py recipe=moire_at
    python training/fit.py -m recipe=baseline,moire_at seed=0,1
    python training/fit.py recipe=moire_at data=folder data.root=DIR

Recipes: recipes/*.yaml. A run writes report.html, metrics.json, best.ckpt, last.ckpt and
config.yaml into runs/<recipe>/seed<k>/; with other data or another model than the default the
folder is runs/<data>-<model>/<recipe>/seed<k>/.

Most recipes start from the weights of recipe `clean` and are compared with recipe `baseline`, plain
training that starts from the same weights and takes at least as many epochs. Both are trained
first, with the same settings, or reused if they were trained before; they are reported once their
own recipe is asked for. The same command resumes an interrupted run.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __name__ == "__main__":  # search the repository, not this folder: a user has a models.py too
    sys.path[: not sys.flags.safe_path] = [str(Path(__file__).resolve().parents[1])]

# before torch is loaded, as it sets how torch's threads wait
import training  # noqa: F401  # isort: skip
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import hydra
from omegaconf import DictConfig

from moireaug.evaluation import report
from training import reattack
from training.attack.protocol import Attacked, Protocol, attack, protocol_of
from training.attack.results import about, compare, describe, publish, write_metrics
from training.classifier import adversaries
from training.config import commands, scenes
from training.config.compose import WITH_RECIPE, register
from training.config.schema import Adversary, Config, as_config
from training.config.settings import with_absolute_paths
from training.data.load import load, require_training_images
from training.data.splits import Splits
from training.models.classifiers import require_known
from training.runs import saved
from training.runs.folder import (
    PLAIN_RECIPES,
    RunFolder,
    baseline_config,
    locked_run,
    require_resumable,
    result_settings,
    run_folder,
    run_of,
    start_config,
    write_settings,
)
from training.system.files import make_folder, read_metrics
from training.system.processes import is_first, say

if TYPE_CHECKING:
    from training.classifier.module import Classifier

Metrics = dict[str, Any]
RESTORE = "Restore them (another image may stand in for a damaged file)"


def fit(cfg: DictConfig | Config) -> Metrics:
    """Train and report a run and those it is compared with, or what is left; return its metrics.

    Raises:
        TypeError, ValueError: invalid settings, before any time is spent.
        ConnectionError, FloatingPointError, OSError: as `train_model`.
    """
    cfg = with_absolute_paths(as_config(cfg))
    cfg = replace(cfg, scene=scenes.inlined(cfg.scene))
    check(cfg)
    run = run_of(cfg)
    if is_first():
        make_folder(run.folder)
    with locked_run(run.folder):
        if cfg.resume is not False:
            require(saved.other_weights(run, cfg.weights), run, "Restore that file")
        if cfg.resume is not False and (run.stage() == "finished" or unreported(cfg)):
            return finished(cfg)
        if cfg.resume and is_first():
            plain = (start_config(cfg), baseline_config(cfg))
            require_resumable(run, *[run_of(other) for other in plain if other])
        from training.classifier.train import try_out  # Lightning, which takes seconds to import

        began = time.perf_counter()
        splits = load(cfg.data)
        if cfg.resume is not False:
            require(saved.other_data(run, splits), run)
        try_out(cfg, splits)
        spent = {"data": time.perf_counter() - began}
        start, baseline = plain_runs(cfg, splits)
        return one_run(cfg, splits, start, baseline, spent)


def require(difference: str | None, run: RunFolder, advice: str = RESTORE) -> None:
    """Refuse to go on with a run on other data than it was trained on, or from other weights:
    images that it was trained on would validate it, or classes change their meaning.

    Args:
        difference: from `saved.other_data` or `saved.other_weights`.
        advice: what to do about it.

    Raises:
        ValueError: with what differs.
    """
    if difference:
        raise ValueError(
            f"the run in {run.folder} cannot go on: {difference}. {advice}, or pass resume=false, "
            "which moves that run aside and trains again."
        )


def unreported(cfg: Config) -> bool:
    """Return whether this run was trained as the start or baseline of another, and not attacked."""
    known = trained_before(cfg)
    return known is not None and "reattack" not in known


def trained_before(cfg: Config) -> Metrics | None:
    """Return the metrics of a run that was trained with these settings; None for no such run. How
    it was attacked may differ."""
    out = run_folder(cfg)
    known = read_metrics(out)
    if not known or not (out / "best.ckpt").is_file():
        return None
    if not saved.same_but_attack(known.get("config") or {}, result_settings(cfg)):
        return None
    return known


def finished(cfg: Config) -> Metrics:
    """Print the summary of a finished run and return its metrics.

    One that was trained as the start or baseline of another run is attacked and reported now.
    """
    out = run_folder(cfg)
    known = read_metrics(out) or {}
    if not is_first():
        return known
    if "trust" in known:
        report.show(report.run_parts(known))
    else:
        splits = load(cfg.data)
        require(saved.other_data(run_of(cfg), splits), run_of(cfg))
        attacked = again(cfg, protocol_of(cfg, splits), check=True)
        trained_on = known["environment"]
        known |= {**about(cfg), **describe(attacked), "environment": trained_on}
        write_settings(cfg)
        spent = {**(known.get("time") or {}), **attacked.seconds}
        known = publish(out, known, {cfg.recipe: attacked}, splits.classes, spent)
    print(f"{out} is already finished; resume=false trains it again.")
    return known


def check(cfg: Config) -> None:
    """Refuse invalid settings before any time is spent.

    Raises:
        TypeError, ValueError: with what was got and what is allowed.
    """
    reattack.check(cfg)
    require_known(cfg.model)
    adversaries.check(cfg.adversary)
    require_training_images(cfg.data)
    if cfg.recipe in PLAIN_RECIPES and cfg.adversary != Adversary():
        raise ValueError(
            f"recipe={cfg.recipe} is plain training, which the others are compared with: leave "
            "adversary.* out."
        )
    if cfg.recipe == "clean" and cfg.train.init == "clean":
        raise ValueError(
            "train.init=clean starts from recipe clean, which has no such start itself: use random."
        )


def plain_runs(cfg: Config, splits: Splits) -> tuple[Metrics | None, Metrics | None]:
    """Return the metrics of the start and the baseline, reused or trained; None for neither."""
    start = baseline = None
    if wanted := start_config(cfg):
        start = plain_run(wanted, splits, None, role="start")
    if wanted := baseline_config(cfg):
        baseline = plain_run(wanted, splits, start, role="baseline")
    return start, baseline


def plain_run(cfg: Config, splits: Splits, start: Metrics | None, *, role: str) -> Metrics:
    """Return the metrics of a start or baseline: reused, or trained and not attacked.

    A damaged one is moved aside.

    Args:
        start: metrics of the run whose weights it starts from, if any.
        role: "start" or "baseline", for what is printed.
    """
    out = run_folder(cfg)
    if is_first():
        make_folder(out)
    with locked_run(out):
        run = run_of(cfg)
        reason = saved.damage(run) or saved.other_weights(run, cfg.weights)
        if reason := reason or saved.other_data(run, splits):
            say(f"The {role} cannot be reused and is trained again: {reason}.")
            cfg = replace(cfg, resume=False)
        elif known := trained_before(cfg):
            say(f"The {role} is reused from {out}.")
            return known
        else:
            say(f"The {role} comes first: recipe {cfg.recipe}, with the same settings.")
        _, train = train_run(cfg, splits, start)
        if not is_first():
            return {}
        metrics = compare(cfg, {}, train, start, None)
        return write_metrics(out, metrics | {"time": {"train": train["wall_seconds"]}})


def again(cfg: Config, protocol: Protocol, *, check: bool = False) -> Attacked:
    """Attack a trained run again, reusing what its records hold."""
    found = saved.finished(cfg)
    return attack(found.model(), protocol, found.folder / "records", cfg.recipe, check=check)


def one_run(
    cfg: Config,
    splits: Splits,
    start: Metrics | None,
    baseline: Metrics | None,
    spent: Mapping[str, float],
) -> Metrics:
    """Train, attack, compare and report one run; returns its metrics, {} in all but one process.

    Args:
        start, baseline: metrics of the runs beside it. spent: seconds so far, by phase.
    """
    classifier, train = train_run(cfg, splits, start)
    if not is_first():
        return {}
    out = run_folder(cfg)
    protocol = protocol_of(cfg, splits)
    attacked = {cfg.recipe: attack(classifier.model, protocol, out / "records", cfg.recipe)}
    # also where its records are there: a folder's images may have changed since
    if baseline and (other := baseline_config(cfg)):
        attacked[other.recipe] = again(other, protocol)
        baseline = baseline | describe(attacked[other.recipe])
    metrics = compare(cfg, describe(attacked[cfg.recipe]), train, start, baseline)
    seconds = {**spent, "train": train["wall_seconds"], **attacked[cfg.recipe].seconds}
    return publish(out, metrics, attacked, splits.classes, seconds)


def train_run(
    cfg: Config, splits: Splits, start: Metrics | None
) -> tuple[Classifier, dict[str, Any]]:
    """Train a run in its folder, or what is left of it; see `train_model`.

    Args:
        start: metrics of the run whose weights it starts from, if any.
    """
    from training.classifier.train import train_model

    if is_first():
        run_of(cfg).prepare()
    return train_model(cfg, splits, before=start["train"] if start else None)


@hydra.main(version_base="1.3", config_path=None, config_name="fit")
def main(cfg: DictConfig) -> None:
    """Run one job of the command line."""
    with commands.sentences(kept="Every complete epoch is kept"):
        fit(cfg)


register("fit", Config, WITH_RECIPE, __doc__)
if __name__ == "__main__":
    commands.run(main, Config)
