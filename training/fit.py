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

from training.config import hydra_commands
from training.config.compose import RECIPE_GROUPS, register
from training.config.schema import RECIPES, Config, as_config


def fit(cfg: Config) -> dict[str, Any]:
    """Train and report a run and those it is compared with, or the rest of it; return its metrics.

    Raises: as `training.runs.task.fit`.
    """
    # --help does without what takes a second to import
    from training.recipe.phases import ClassificationTask
    from training.runs import task

    return task.fit(cfg, ClassificationTask())


@hydra.main(version_base="1.3", config_path=str(RECIPES), config_name="fit")
def main(cfg: DictConfig) -> None:
    """Run one job of the command line."""
    with hydra_commands.report_job_errors(kept_work="Every complete epoch is kept"):
        from training.trainer.ranks import run_job

        config: Config = as_config(cfg)
        run_job(config.trainer, fit, config)


register("fit", Config, RECIPE_GROUPS, __doc__)
if __name__ == "__main__":
    hydra_commands.run(main, Config)
