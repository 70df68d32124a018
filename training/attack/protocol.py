"""Attack a model with a suite: the protocol, the jobs that are left, and the results."""

import sys
import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
from torch import nn

from moireaug.evaluation import Table
from moireaug.evaluation.frame import images_frame, rates
from moireaug.evaluation.records import EvalSetup, RecordFolder
from moireaug.evaluation.runner import Job, Runner, jobs_of, show_progress
from moireaug.evaluation.suites.trust import checks, trust
from moireaug.evaluation.visibility import LPIPS
from moireaug.mixtures import Mixture
from moireaug.scenes import Scene
from training.config.scenes import scene_of
from training.config.schema import Config, Reattack
from training.data.splits import EvalBatches, Splits
from training.report.published import with_paper
from training.suites import tables_of
from training.suites.config import PaperConfig
from training.system import machine

MAX_CHECKED_IMAGES = 96  # images that the checks look at, in whole batches


class Protocol(NamedTuple):
    """How every model of a comparison is attacked.

    Args:
        lpips: network that measures LPIPS; None for none.
        shrink: that of the scene, for a suite's other scenes; None where images are whole photos.
    """

    batches: EvalBatches
    scene: Scene | Mixture
    settings: Reattack
    lpips: LPIPS | None = None
    shrink: Any = None

    def config(self) -> PaperConfig:
        """Return the configuration of suites, without targets and further defences."""
        settings = self.settings
        eps = None if settings.eps is None else tuple(settings.eps)
        return PaperConfig(scene=self.scene, shrink=self.shrink, eps=eps, steps=settings.steps)

    @property
    def checked_batches(self) -> range:
        """Indices of the batches that the checks look at."""
        return range(min(len(self.batches), -(-MAX_CHECKED_IMAGES // self.batches.size)))


def protocol_of(
    cfg: Config, splits: Splits, lpips: LPIPS | None = None, original: nn.Module | None = None
) -> Protocol:
    """Return the protocol that these settings describe.

    Args:
        original: classifier whose answers are the labels; None for those of the data.
    """
    device = machine.device(cfg.trainer.accelerator)
    batches = EvalBatches(splits, cfg.reattack, cfg.data.size, device, original)
    return Protocol(batches, scene_of(cfg), cfg.reattack, lpips, cfg.shrink)


@dataclass(frozen=True)
class AttackResult:
    """The results of a suite on one model.

    Args:
        cells: rates of these tables, one row per cell.
        checks: metrics `trust`, the checks of whether the figures can be trusted, and `trust_n`,
            their number of images; empty without checks.
        runner: runner of the suite, for the report's pictures; its name is a digest of the model.
        seconds: time spent, by phase.
    """

    tables: list[Table]
    cells: pd.DataFrame
    checks: dict[str, Any]
    runner: Runner
    seconds: dict[str, float]


class SuiteAttack:
    """A suite on one model: its jobs, and the records of those that are done.

    Args:
        model: classifier of [0, 1] images (B, 3, H, W), which returns logits (B, classes).
        config: configuration of the suite; None is the protocol's.
        check: whether to check that the figures can be trusted.
    """

    def __init__(
        self,
        model: nn.Module,
        suite: str,
        protocol: Protocol,
        records: Path,
        config: PaperConfig | None = None,
        *,
        check: bool = True,
    ) -> None:
        self.config = config or protocol.config()
        self.tables = tables_of(suite, self.config)
        self.trust_table = trust(self.config)
        self.all_batches = range(len(protocol.batches))
        self.checked_batches = self.all_batches if suite == "trust" else protocol.checked_batches
        self.check = check
        self.phases = {"re-attack": (jobs_of(self.tables), self.all_batches)}
        if check:
            self.phases["checks"] = (jobs_of([self.trust_table]), self.checked_batches)
        model = model.to(protocol.batches.device).eval()
        settings = protocol.settings
        self.records = RecordFolder(records)
        setup = EvalSetup(protocol.scene, settings.seed, settings.bound, protocol.lpips)
        self.runner = Runner(model, protocol.batches, setup, self.records)
        self.seconds: dict[str, float] = {}

    def run(self, title: str, rank: int = 0, world: int = 1) -> None:
        """Do this process's share of the jobs that are left: every `world`-th batch."""
        for phase, (jobs, all_indices) in self.phases.items():
            start = time.perf_counter()
            indices = all_indices[rank::world]
            progress = self.runner.run(jobs, indices)
            count = len(jobs) * len(indices)
            is_shown = rank == 0 and sys.stderr.isatty()
            for _ in show_progress(progress, count, f"{title}, {phase}", enabled=is_shown):
                pass
            self.seconds[phase] = time.perf_counter() - start

    def results(self) -> AttackResult:
        """Return the rates and checks, from the records of all processes."""
        self.records.read()
        require_all_records(self.runner, self.phases.values())
        images = images_frame(self.tables, self.runner, self.all_batches)
        cells = with_paper(rates(images), self.config.middle)
        check_metrics: dict[str, Any] = {}
        if self.check:
            trust_images = images_frame([self.trust_table], self.runner, self.checked_batches)
            trust_checks = checks(self.config, trust_images, rates(trust_images))
            check_metrics["trust"] = [asdict(one) for one in trust_checks]
            check_metrics["trust_n"] = int(trust_images["image"].nunique())
        return AttackResult(
            tables=[table for table in self.tables if table.name != "trust"],
            cells=cells[cells["table"] != "trust"],
            checks=check_metrics,
            runner=self.runner,
            seconds=self.seconds,
        )


def attack(
    model: nn.Module, protocol: Protocol, records: Path, title: str, *, check: bool = True
) -> AttackResult:
    """Attack a model with the ladder; records that are there are not computed again."""
    ladder = SuiteAttack(model, "ladder", protocol, records, check=check)
    ladder.run(title)
    return ladder.results()


def require_all_records(runner: Runner, phases: Iterable[tuple[list[Job], range]]) -> None:
    """Check that no records are missing."""
    missing = total = 0
    for jobs, indices in phases:
        missing += runner.missing(jobs, indices)
        total += len(indices) * sum(len(job.classifiers) for job in jobs)
    if missing:
        raise ValueError(
            f"{missing} of {total} records are missing: other processes did not finish, or write "
            "to a folder that this one cannot see. Run the same command again, with runs= on a "
            "disk that all nodes share."
        )
