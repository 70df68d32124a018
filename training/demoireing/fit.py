"""Train a demoiréing network on simulated pairs alone, test it, and report what it cleans.

    python training/demoire.py train                                   # on drawn pictures
    python training/demoire.py train data.root=DIR model=esdnet pairs=PAIRS.csv
    python training/demoire.py train scene=phone_at_monitor demoire.target=original

`pairs` names real photos and what was on the screen, for the report alone; with other pairs, test.*
or data.test, a finished run is only tested again. Writes weights.pt (for training/demoire.py clean
and moireaug.defenses.demoire.load), report.html, scores.csv (the figures of each pair),
metrics.json, best.ckpt, last.ckpt and config.yaml into runs/<data>-<model>/demoire/seed<k>/. The
same command resumes an interrupted run.
"""

import time
from collections.abc import Sequence
from pathlib import Path

import hydra
from omegaconf import DictConfig

from moireaug.common.argument_checks import one_of
from moireaug.common.files import write_text
from moireaug.defenses import demoire
from moireaug.defenses.demoire.losses import NETWORKS_WITHOUT_FEATURES
from moireaug.mixtures import as_scene
from moireaug.synthesis.pairs import check_aligned
from training.config import hydra_commands
from training.config.checks import check_run
from training.config.compose import register
from training.config.schema import RECIPES, as_config
from training.data.real_pairs import find_pairs, fingerprint, require_one_size
from training.demoireing import pictures, report
from training.demoireing.pairs import training_scenes
from training.demoireing.schema import DemoireConfig
from training.demoireing.testing import summarise, test_network
from training.runs import task
from training.runs.layout import NETWORK, REPORT, read_metrics, write_metrics
from training.runs.run import Run
from training.runs.task import Metrics, Task
from training.system import machine
from training.system.processes import is_first
from training.trainer.ranks import run_job


class DemoireingTask(Task[DemoireConfig, pictures.Splits]):
    """Photos without moiré: trained on simulated pairs, and tested on these and on real ones."""

    def check(self, cfg: DemoireConfig) -> None:
        one_of("model", cfg.model, demoire.NETWORKS)
        check_run(cfg)
        if cfg.train.steps % cfg.train.check_every:
            raise ValueError(
                "train.steps must be a multiple of train.check_every, so that the last weights are "
                f"validated; got {cfg.train.steps} and {cfg.train.check_every}."
            )
        if cfg.demoire.vgg and cfg.model in NETWORKS_WITHOUT_FEATURES:
            raise ValueError(
                f"demoire.vgg= has no effect on {cfg.model}, whose published loss compares no "
                "features: leave it out."
            )
        trained_scenes = training_scenes(cfg)
        for name in cfg.test.unseen:
            check_aligned(as_scene(name))
            if name in trained_scenes:
                raise ValueError(
                    f"test.unseen names {name}, which is trained on too: leave it out of one of "
                    "them."
                )
        if cfg.pairs:
            for pair in find_pairs(Path(cfg.pairs)):
                require_one_size(pair)

    def finished(self, run: Run[DemoireConfig]) -> tuple[Metrics, list[str]] | None:
        metrics = read_metrics(run.folder)
        if not metrics or run.stage() != "finished" or has_other_pairs(run):
            return None
        return metrics, report.terminal_parts(metrics)

    def runs_before(self, run: Run[DemoireConfig]) -> list[Run[DemoireConfig]]:
        return []

    def load(self, cfg: DemoireConfig) -> pictures.Splits:
        splits = pictures.load(cfg)
        pictures.require_usable(splits)
        return splits

    def try_out(self, run: Run[DemoireConfig], data: pictures.Splits) -> None:
        from training.demoireing.train import try_out  # Lightning takes seconds to import

        try_out(run)

    def train_and_test(
        self, run: Run[DemoireConfig], data: pictures.Splits, data_seconds: float
    ) -> Metrics:
        from training.demoireing.train import train_network  # Lightning takes seconds to import

        network, train = train_network(run, data)
        if not is_first():
            return {}
        demoire.save(network, run.folder / NETWORK)
        return test_and_report(run, network, train, data)


def fit(cfg: DemoireConfig) -> Metrics:
    """Train, test and report a run, or the rest of it; return its metrics.

    Raises: as `training.runs.task.fit`.
    """
    return task.fit(cfg, DemoireingTask())


def has_other_pairs(run: Run[DemoireConfig]) -> bool:
    """Return whether `pairs=` names other real pairs than the run was tested on; False where it
    names none."""
    if not run.config.pairs:
        return False
    pairs = find_pairs(Path(run.config.pairs))
    return fingerprint(pairs) != (read_metrics(run.folder) or {}).get("pairs_fingerprint")


def test_and_report(
    run: Run[DemoireConfig], network: demoire.DemoireNet, train: Metrics, splits: pictures.Splits
) -> Metrics:
    """Test a trained network, and write scores.csv, report.html and then metrics.json; returns the
    metrics."""
    cfg, folder = run.config, run.folder
    network.to(machine.device(cfg.trainer.accelerator))  # training leaves it on the CPU
    start = time.perf_counter()
    result = test_network(network, cfg, splits)
    metrics: Metrics = {
        **run.facts(),
        "width": cfg.demoire.width,
        "target": cfg.demoire.target,
        "pairs": cfg.pairs,
        "pairs_fingerprint": fingerprint(find_pairs(Path(cfg.pairs))) if cfg.pairs else None,
        "train": train,
        "test": summarise(result.scores),
        "time": {"train": train["wall_seconds"], "test": time.perf_counter() - start},
        "scenes": {name: scene.to_dict() for name, scene in training_scenes(cfg).items()},
    }
    precision = str(cfg.trainer.precision or machine.DEFAULT_PRECISION)
    metrics["environment"]["precision"] = precision
    write_text(folder / "scores.csv", result.scores.to_csv(index=False, float_format="%.6g"))
    write_text(folder / REPORT, report.page(metrics, result.examples))
    write_metrics(folder, metrics)
    print(*report.terminal_parts(metrics), sep="\n")
    print(f"Weights: {folder / NETWORK}")
    print(f"Report: {folder / REPORT}")
    return metrics


@hydra.main(version_base="1.3", config_path=str(RECIPES), config_name="demoire")
def job(cfg: DictConfig) -> None:
    """Run one job of the command line."""
    with hydra_commands.report_job_errors(kept_work="What was validated is kept"):
        config: DemoireConfig = as_config(cfg)
        run_job(config.trainer, fit, config)


def main(argv: Sequence[str]) -> None:
    """Run the settings at the end of the command line, or their sweep."""
    hydra_commands.run(job, DemoireConfig, argv)


register("demoire", DemoireConfig, (), __doc__)
