"""Attack a model with a suite: the protocol, the work left to do, and the results."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
from torch import nn

from moireaug.attacks import MoireAttack
from moireaug.attacks.checks import check_bounds
from moireaug.evaluation import SuiteConfig, Table, tables_of
from moireaug.evaluation.evaluate import show_progress
from moireaug.evaluation.frame import images_frame, rates, with_paper
from moireaug.evaluation.records import RecordFolder
from moireaug.evaluation.runner import Job, Runner, jobs_of
from moireaug.evaluation.tables import DEFAULT_EPS
from moireaug.evaluation.trust import trust
from moireaug.evaluation.trust_checks import checks
from moireaug.evaluation.visibility import LPIPS
from moireaug.mixtures import Mixture
from moireaug.scenes import Scene
from training.config.checks import check_classifier
from training.config.schema import Config, Reattack, scene_of
from training.data.eval_batches import EvalBatches
from training.data.load import require_used
from training.data.splits import Splits
from training.system import machine

TRUST_N = 96  # images that the checks look at, in whole batches
Metrics = dict[str, Any]


class Protocol(NamedTuple):
    """How every model of a comparison is attacked: on which images, in which scene, how strongly;
    and whether LPIPS is measured."""

    batches: EvalBatches
    scene: Scene | Mixture
    settings: Reattack
    lpips: LPIPS | None = None

    def config(self) -> SuiteConfig:
        """Return the configuration of suites, without targets and further defences."""
        own = self.settings
        eps = None if own.eps is None else tuple(own.eps)
        return SuiteConfig(scene=self.scene, eps=eps, steps=own.steps)

    @property
    def trusted(self) -> range:
        """The batches that the checks look at."""
        return range(min(len(self.batches), -(-TRUST_N // self.batches.size)))


def protocol_of(cfg: Config, splits: Splits) -> Protocol:
    """Return the protocol that these settings describe."""
    batches = EvalBatches(
        splits, cfg.reattack, cfg.data.size, machine.device(cfg.trainer.accelerator)
    )
    return Protocol(batches, scene_of(cfg), cfg.reattack)


def check_attack(cfg: Config) -> None:
    """Refuse invalid settings of data, scene and attack before any time is spent.

    Raises:
        TypeError, ValueError: with what was got and what is allowed.
    """
    check_classifier(cfg)
    require_used(cfg.data)
    check_bounds(DEFAULT_EPS if cfg.reattack.eps is None else cfg.reattack.eps)
    MoireAttack(nn.Identity(), scene=scene_of(cfg), steps=cfg.reattack.steps)


@dataclass(frozen=True)
class Attacked:
    """The results of a suite on one model.

    Args:
        tables: of the suite. lines: their rates, one row per cell.
        checks: `trust`, whether the figures can be trusted, on `trust_n` images; empty if not
            asked for.
        runner: for the report's pictures; its name is a digest of the model.
        seconds: time spent, by phase.
    """

    tables: list[Table]
    lines: pd.DataFrame
    checks: Metrics
    runner: Runner
    seconds: dict[str, float]


class Plan:
    """A suite on one model: the work to do, and the records that keep what is done.

    Args:
        model: [0, 1] images to logits. suite: its name. protocol: how the model is attacked.
        records: folder where each finished piece is kept.
        config: of the suite; None uses the protocol's.
        check: whether to check that the figures can be trusted.
    """

    def __init__(
        self,
        model: nn.Module,
        suite: str,
        protocol: Protocol,
        records: Path,
        config: SuiteConfig | None = None,
        *,
        check: bool = True,
    ) -> None:
        self.config = config or protocol.config()
        self.tables = tables_of(suite, self.config)
        self.trust = trust(self.config)
        self.every = range(len(protocol.batches))
        self.trusted = self.every if suite == "trust" else protocol.trusted
        self.check = check
        self.phases = {"re-attack": (jobs_of(self.tables), self.every)}
        if check:
            self.phases["checks"] = (jobs_of([self.trust]), self.trusted)
        model = model.to(protocol.batches.device).eval()
        settings = protocol.settings
        self.kept = RecordFolder(records)
        self.runner = Runner(
            model,
            protocol.batches,
            protocol.scene,
            self.kept,
            seed=settings.seed,
            lpips=protocol.lpips,
        )
        self.seconds: dict[str, float] = {}

    def run(self, title: str, rank: int = 0, world: int = 1) -> None:
        """Do this process's share of what is not done yet: every `world`-th batch.

        Args:
            title: name of the model, for the progress bar.
            rank, world: number of this process, and how many there are.
        """
        with self.kept:
            for phase, (jobs, indices) in self.phases.items():
                began = time.perf_counter()
                mine = indices[rank::world]
                done = self.runner.run(jobs, mine)
                total = len(jobs) * len(mine)
                shown = rank == 0 and sys.stderr.isatty()
                for _ in show_progress(done, total, f"{title}, {phase}", enabled=shown):
                    pass
                self.seconds[phase] = time.perf_counter() - began

    def results(self) -> Attacked:
        """Return the rates and checks, from the records of all processes.

        Raises:
            ValueError: records are missing, because another process did not finish.
        """
        self.kept.read()
        require_whole(self.runner, self.phases.values())
        images = images_frame(self.tables, self.runner, self.every)
        lines = with_paper(rates(images), self.tables)
        found: Metrics = {}
        if self.check:
            trusted = images_frame([self.trust], self.runner, self.trusted)
            passed = checks(self.config, trusted, rates(trusted))
            found["trust"] = [one.to_dict() for one in passed]
            found["trust_n"] = int(trusted["image"].nunique())
        return Attacked(
            tables=[table for table in self.tables if table.name != "trust"],
            lines=lines[lines["table"] != "trust"],
            checks=found,
            runner=self.runner,
            seconds=self.seconds,
        )


def attack(
    model: nn.Module, protocol: Protocol, records: Path, title: str, *, check: bool = True
) -> Attacked:
    """Attack a model with the ladder; what the records hold is not computed again.

    Args:
        model: [0, 1] images to logits. protocol: how it is attacked.
        records: folder where each finished piece is kept.
        title: name of the model, for the progress bar.
        check: whether to check that the figures can be trusted.
    """
    plan = Plan(model, "ladder", protocol, records, check=check)
    plan.run(title)
    return plan.results()


def require_whole(runner: Runner, phases: Iterable[tuple[list[Job], range]]) -> None:
    """Check that no records are missing.

    Raises:
        ValueError: some are; says how many, and what to do.
    """
    missing = wanted = 0
    for jobs, indices in phases:
        missing += runner.missing(jobs, indices)
        wanted += len(indices) * sum(len(job.judges) for job in jobs)
    if missing:
        raise ValueError(
            f"{missing} of {wanted} records are missing: other processes did not finish, or "
            f"write to a folder that "
            "this one cannot see. Run the same command again, with runs= on a disk that all "
            "nodes share."
        )
