r"""Attack a run's best checkpoint, or a torchvision model with given weights on a folder of images.
Any other classifier: `moireaug.evaluation.evaluate` in Python.

    python training/reattack.py run=runs/moire_at/seed0
    python training/reattack.py run=runs/moire_at/seed0 scene=dashcam_at_led_sign reattack.n=1600
    python training/reattack.py model=mobilenet_v2 weights=FILE data=folder data.root=DIR \
        data.class_index=CSV data.size=224 scene=paper_code suite=paper \
        targets='{resnet18: FILE, resnet50: FILE}'

Writes report.html and metrics.json into <run>/reattack/<scene>-n<images>-steps<steps>/<suite>/, or,
without `run=`, into runs/reattack/<model>/<data>-<scene>-n<images>-steps<steps>/<suite>/; a suite
other than the ladder writes tables.md and results.csv too. With runs=DIR beside run=, for a run
that cannot be written, all goes where DIR would hold the run. The baseline of a run is attacked
too, if its folder holds it with the same settings. Every finished piece is kept in records/: the
same command continues where it stopped, and another suite reuses what is there.
"""

import sys
from pathlib import Path

if __name__ == "__main__":  # search the repository, not this folder: a user has a models.py too
    sys.path[: not sys.flags.safe_path] = [str(Path(__file__).resolve().parents[1])]

# before torch is loaded, as it sets how torch's threads wait
import training  # noqa: F401  # isort: skip
from dataclasses import replace
from datetime import timedelta
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from torch.distributed import barrier, new_group

from moireaug.common.argument_checks import one_of
from training.attack.protocol import AttackResult, SuiteAttack
from training.attack.results import (
    Rival,
    attack_and_publish,
    plain_metrics,
    publish_suite,
    run_metrics,
)
from training.attack.subject import Subject, subject_of_run, subject_of_weights
from training.attack.suite_config import suite_config
from training.config import hydra_commands, scenes
from training.config.checks import check_classifier, check_overrides, keys_of, merge_run_settings
from training.config.compose import DATA_GROUPS, register
from training.config.schema import RECIPES, ReattackConfig, as_config
from training.runs.layout import RECORDS
from training.runs.metrics import ORIGINAL, Metrics, RunMetrics
from training.runs.run import Run, locked_folder
from training.runs.trained import TrainedRun, read, read_baseline_of, read_training_cost
from training.suites import GROUPS, SUITES
from training.system.processes import join_launch
from training.trainer.ranks import fabric_of, run_job

# the first process to finish waits for the last: longer than the half hour that torch allows
MAX_WAIT = timedelta(days=30)


def reattack(config: ReattackConfig, overrides: list[str]) -> dict[str, Any]:
    """Attack a run or a named model; returns the metrics, {} in all processes but the first.

    Args:
        overrides: those of the command line, which take precedence over a run's own settings.
    """
    config = scenes.with_files(config)
    check_overrides(config, overrides)
    run = None if config.run is None else read(Path(config.run))
    if run:
        config = merge_run_settings(run.cfg, config, overrides)
    check(config)
    home = None
    if run and "runs" in keys_of(overrides):  # where the run would lie in that folder
        home = Run(replace(run.cfg, runs=config.runs)).folder
    subject = subject_of_run(config, run, home or run.folder) if run else subject_of_weights(config)
    metrics = attack_subject(config, subject, run, home)
    return metrics.to_dict() if metrics else {}


def check(cfg: ReattackConfig) -> None:
    """Refuse invalid settings before any time is spent."""
    check_classifier(cfg)
    one_of("suite", cfg.suite, (*SUITES, *GROUPS))


def attack_subject(
    cfg: ReattackConfig, subject: Subject, run: TrainedRun | None, home: Path | None = None
) -> Metrics | None:
    """Attack a classifier and publish the results; with the ladder also the baseline of its run.

    Args:
        home: folder for the records of both, instead of their own; None for those.
    """
    with locked_folder(subject.folder):
        if cfg.suite == "ladder":
            return attack_by_ladder(cfg, subject, run, home)
        result = attack_by_suite(cfg, subject)
        return publish_suite(cfg, subject, result) if result else None


def attack_by_ladder(
    cfg: ReattackConfig, subject: Subject, run: TrainedRun | None, home: Path | None
) -> RunMetrics:
    """Attack a classifier, and the baseline of its run, with the ladder; publish the results."""
    metrics = run_metrics(cfg, read_training_cost(run.folder) if run else None, None)
    metrics = replace(metrics, time=subject.seconds)
    return attack_and_publish(subject, metrics, run and rival_of(cfg, subject, run, home))


def rival_of(
    cfg: ReattackConfig, subject: Subject, run: TrainedRun, home: Path | None
) -> Rival | None:
    """Return the classifier that a run is compared with: the network whose answers it was to keep,
    or its baseline; None where that is not there."""
    if original := run.original_model():
        return Rival(plain_metrics(cfg, ORIGINAL), original, subject.records)
    baseline = read_baseline_of(run)
    if baseline is None:
        return None
    baseline.check_classes(subject.splits, cfg.data)
    metrics = plain_metrics(baseline.cfg, baseline.cfg.recipe, read_training_cost(baseline.folder))
    records = subject.records if home else baseline.folder / RECORDS
    return Rival(metrics, baseline.model(), records)


def attack_by_suite(cfg: ReattackConfig, subject: Subject) -> AttackResult | None:
    """Attack a classifier by `cfg.suite`, shared among the processes that the trainer's settings
    ask for; return the results in the first of them."""
    fabric = fabric_of(cfg.trainer)
    everyone: Any = None
    if fabric.world_size > 1:
        everyone = new_group(backend="gloo", timeout=MAX_WAIT)
    config = suite_config(cfg, subject, fabric)
    suite_attack = SuiteAttack(subject.model, cfg.suite, subject.protocol, subject.records, config)
    suite_attack.run(cfg.suite, fabric.global_rank, fabric.world_size)
    if fabric.world_size > 1:
        barrier(everyone)
    return None if fabric.global_rank else suite_attack.results()


@hydra.main(version_base="1.3", config_path=str(RECIPES), config_name="reattack")
def main(cfg: DictConfig) -> None:
    """Run one job of the command line."""
    with hydra_commands.report_job_errors(kept_work="Every record is kept"):
        config: ReattackConfig = as_config(cfg)
        overrides = list(HydraConfig.get().overrides.task)
        if config.suite == "ladder":  # in one process
            join_launch(1)
            reattack(config, overrides)
        else:
            run_job(config.trainer, reattack, config, overrides)


register("reattack", ReattackConfig, DATA_GROUPS, __doc__)
if __name__ == "__main__":
    hydra_commands.run(main, ReattackConfig)
