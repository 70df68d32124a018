"""Train a classifier against the Moiré Attack, attack it again, and report gain and cost.

    python training/fit.py recipe=moire_at 'shrink=[1,3]'     # drawn signs, as crops of photos
    python training/fit.py -m recipe=baseline,moire_at seed=0,1 'shrink=[1,3]'
    python training/fit.py recipe=moire_at data=folder data.root=DIR

Recipes: recipes/*.yaml. A run writes report.html, metrics.json, best.ckpt, last.ckpt and
config.yaml into runs/<recipe>/seed<k>/; with other data or another model than the default the
folder is runs/<data>-<model>/<recipe>/seed<k>/.

Most recipes start from the weights of recipe `clean` and are compared with recipe `baseline`, plain
training that starts from the same weights and takes at least as many epochs. Both are trained
first, with the same settings, or reused if they were trained before; for a report of their own, run
recipe=baseline. The same command resumes an interrupted run.
"""

import sys
from pathlib import Path

if __name__ == "__main__":  # search the repository, not this folder: a user has a models.py too
    sys.path[: not sys.flags.safe_path] = [str(Path(__file__).resolve().parents[1])]

# before torch is loaded, as it sets how torch's threads wait
import training  # noqa: F401  # isort: skip
from typing import Any

import hydra
from omegaconf import DictConfig

from training.config import commands, scenes
from training.config.checks import (
    check_answers,
    check_classifier,
    check_search,
    require_training_images,
    require_used,
)
from training.config.compose import RECIPE_GROUPS, register
from training.config.schema import RECIPES, Adversary, Config, as_config
from training.models.classifiers import require_known
from training.recipe.phases import complete, report_finished
from training.runs.identity import Origin
from training.runs.metrics import RunMetrics
from training.runs.resume import require_resumable, require_same_origin
from training.runs.run import PLAIN_RECIPES, Run, baseline_of, start_of
from training.system.processes import is_first
from training.trainer.ranks import run_job


def fit(cfg: Config) -> dict[str, Any]:
    """Train and report a run and those it is compared with, or the rest of it; return its metrics.

    Raises:
        TypeError, ValueError: invalid settings, before any time is spent.
        ConnectionError, FloatingPointError, OSError: as `train_model`.
    """
    cfg = scenes.with_files(cfg)
    check(cfg)
    run = Run(cfg)
    if cfg.resume is not False:
        require_same_origin(run, Origin.of(cfg.weights))
        if run.stage() == "finished":  # only read, and where nothing can be written too
            return as_dict(report_finished(run))
    with run.locked():
        if cfg.resume and is_first():
            require_resumable(run, start_of(run), baseline_of(run))
        return as_dict(complete(run))


def as_dict(metrics: RunMetrics | None) -> dict[str, Any]:
    """Return the content of metrics.json; {} in all processes but the first."""
    return metrics.to_dict() if metrics else {}


def check(cfg: Config) -> None:
    """Refuse invalid settings before any time is spent."""
    check_classifier(cfg)
    check_search(cfg)
    if cfg.train.target == "answers":
        check_answers(cfg)
    else:
        require_training_images(cfg.data)
    require_known(cfg.model)
    if cfg.recipe in PLAIN_RECIPES and cfg.adversary != Adversary():
        raise ValueError(
            f"recipe={cfg.recipe} is plain training, which the others are compared with: leave "
            "adversary.* out."
        )
    if cfg.recipe == "clean" and cfg.train.init == "clean":
        raise ValueError(
            "train.init=clean starts from recipe clean, which has no such start itself: use random."
        )
    require_used(cfg, "adversary", "train")


@hydra.main(version_base="1.3", config_path=str(RECIPES), config_name="fit")
def main(cfg: DictConfig) -> None:
    """Run one job of the command line."""
    with commands.report_job_errors(kept_work="Every complete epoch is kept"):
        config: Config = as_config(cfg)
        run_job(config.trainer, fit, config)


register("fit", Config, RECIPE_GROUPS, __doc__)
if __name__ == "__main__":
    commands.run(main, Config)
