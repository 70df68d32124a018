"""What a model is worth: attacked by a suite, compared with the runs beside it, and reported."""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
import torch
from torch import nn

from moireaug.evaluation import SuiteConfig, Table, paired_gain, report, tables_of
from moireaug.evaluation.evaluate import with_bar
from moireaug.evaluation.examples import run_examples, table_examples
from moireaug.evaluation.frame import MEASURES, images_frame, rates, with_paper
from moireaug.evaluation.records import RecordFolder
from moireaug.evaluation.runner import Job, Runner, jobs_of
from moireaug.evaluation.suites.ladder import main_attack
from moireaug.evaluation.trust import checks, trust
from moireaug.files import write_text
from moireaug.scene.scene import Scene
from training import runs
from training.data import Splits
from training.eval_batches import EvalBatches
from training.schema import Config, Reattack, Trainer, scene_of
from training.train import with_totals

# what metrics.json says of the start and of the baseline
SHARED = ("recipe", "seed", "data", "model", "clean_accuracy", "train", "reattack")
TRUST_N = 96  # images that the checks look at, in whole batches
Metrics = dict[str, Any]


class Protocol(NamedTuple):
    """How every model of a comparison is attacked: on which images, in which scene, how
    strongly."""

    batches: EvalBatches
    scene: Scene
    settings: Reattack

    def config(self) -> SuiteConfig:
        """Return what suites are built from, without targets and further defences."""
        settings = self.settings
        return SuiteConfig(scene=self.scene, eps=tuple(settings.eps), steps=settings.steps)

    @property
    def trusted(self) -> range:
        """The batches that the checks look at."""
        return range(min(len(self.batches), -(-TRUST_N // self.batches.size)))


def protocol_of(cfg: Config, splits: Splits) -> Protocol:
    """Return how the models of these settings are attacked."""
    batches = EvalBatches(splits, cfg.reattack, cfg.data.size, device(cfg.trainer))
    return Protocol(batches, scene_of(cfg), cfg.reattack)


def device(trainer: Trainer) -> torch.device:
    """Return the GPU where there is one, unless `trainer.accelerator=cpu` asks for the CPU."""
    on_gpu = torch.cuda.is_available() and trainer.accelerator != "cpu"
    return torch.device("cuda" if on_gpu else "cpu")


@dataclass(frozen=True)
class Attacked:
    """A suite on one model.

    Args:
        tables: of the suite. lines: their rates, a line a cell.
        checks: `trust`, whether the figures can be trusted, on `trust_n` images; empty where nobody
            asked.
        runner: for the pictures.
        seconds: by phase.
    """

    tables: list[Table]
    lines: pd.DataFrame
    checks: Metrics
    runner: Runner
    seconds: dict[str, float]


class Plan:
    """A suite on one model: what is to be done, and by which records it is kept.

    Args:
        model: [0, 1] images to logits. suite: its name. protocol: how the model is attacked.
        records: folder where each finished piece is kept.
        config: what the suite is built from; None is the protocol's.
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
        self.suite = suite
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
        self.runner = Runner(model, protocol.batches, protocol.scene, self.kept, seed=settings.seed)
        self.seconds: dict[str, float] = {}

    def run(self, title: str, rank: int = 0, world: int = 1) -> None:
        """Do this process's share of what is not done yet: every `world`-th batch.

        Args:
            title: of the model, for the progress bar.
        """
        with self.kept:
            for phase, (jobs, indices) in self.phases.items():
                began = time.perf_counter()
                mine = indices[rank::world]
                done = self.runner.run(jobs, mine)
                total = len(jobs) * len(mine)
                for _ in with_bar(done, total, f"{title}, {phase}", shown=rank == 0):
                    pass
                self.seconds[phase] = time.perf_counter() - began

    def results(self) -> Attacked:
        """Return the rates and checks, out of every process's records.

        Raises:
            ValueError: records that another process did not finish.
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
    """Attack a model by the ladder, or by what is left of it.

    Args:
        model: [0, 1] images to logits. protocol: how it is attacked.
        records: folder where each finished piece is kept.
        title: of the model, for the progress bar.
        check: whether to check that the figures can be trusted.
    """
    plan = Plan(model, "ladder", protocol, records, check=check)
    plan.run(title)
    return plan.results()


def require_whole(runner: Runner, phases: Iterable[tuple[list[Job], range]]) -> None:
    """Refuse to make tables where records are missing.

    Raises:
        ValueError: with how many, and what to do.
    """
    missing = wanted = 0
    for jobs, indices in phases:
        missing += runner.missing(jobs, indices)
        wanted += len(indices) * sum(len(job.judges) for job in jobs)
    if missing:
        raise ValueError(
            f"{missing} of {wanted} records are missing: other processes did not finish, or "
            f"write to a folder that "
            "this one cannot see. Give the same command again, with runs= on a disk that all "
            "nodes share."
        )


def describe(attacked: Attacked) -> Metrics:
    """Return the ladder as plain values, with every image's outcome as a string of 0 and 1, for
    paired comparisons."""
    rows, outcomes = [], {}
    for line in attacked.lines.to_dict("records"):
        row = {name: line[name] for name in ("eps", "steps", "control", "targeted", "accuracy")}
        row = {"name": line["row"]} | row
        row["accuracy_interval"] = [line["accuracy_low"], line["accuracy_high"]]
        row["success"] = None if pd.isna(line["success"]) else line["success"]
        row["success_interval"] = [line["low"], line["high"]]
        for name in ("n", "counted", "undecided", "seconds"):
            row[name] = line[name]
        for name in MEASURES:
            if not pd.isna(line[name]):
                row[name] = line[name]
        rows.append(row)
        outcomes[line["row"]] = line["outcomes"]
    return {
        "clean_accuracy": rows[0]["accuracy"],
        "reattack": rows,
        "correct": outcomes,
        **attacked.checks,
    }


def compare(
    cfg: Config,
    described: Mapping[str, Any],
    train: Mapping[str, Any] | None,
    start: Mapping[str, Any] | None,
    baseline: Mapping[str, Any] | None,
) -> Metrics:
    """Return the metrics of a run: its own figures, those of the runs beside it, and what it
    gained.

    Args:
        described: the run's own figures. train: what its training cost, where it was trained here.
        start: metrics of the run whose weights it started from. baseline: metrics of the plainly
            trained run, of as many epochs in all, that the gain is against.
    """
    metrics = {
        "recipe": cfg.recipe,
        "seed": cfg.seed,
        "data": cfg.data.name,
        "model": cfg.model,
        "train": train,
        **described,
        **about(cfg),
        "start": _shared(start),
        "baseline": _shared(baseline),
        "gain": {},
        "gain_interval": {},
    }
    if baseline:
        metrics |= gains(metrics["correct"], baseline["correct"])
    return metrics


def about(cfg: Config) -> Metrics:
    """Return what a report says of what was run."""
    scene, settings = scene_of(cfg), runs.settings(cfg)
    return {
        "scene_name": cfg.scene if isinstance(cfg.scene, str) else "custom",
        "scene": scene.to_dict(),
        "plan": str(scene.plan()),
        "config": settings,
        "fingerprint": runs.fingerprint(settings),
        "environment": runs.environment(),
        "command": runs.command(),
    }


def gains(ours: Mapping[str, str], theirs: Mapping[str, str]) -> Metrics:
    """Return the gain in accuracy and its interval, by rung, from every image's outcome."""
    gain, interval = {}, {}
    for name in ours:
        if name in theirs:
            gain[name], low, high = paired_gain(_outcomes(ours[name]), _outcomes(theirs[name]))
            interval[name] = [low, high]
    return {"gain": gain, "gain_interval": interval}


def _outcomes(text: str) -> torch.Tensor:
    return torch.tensor([outcome == "1" for outcome in text])


def _shared(known: Mapping[str, Any] | None) -> Metrics | None:
    """Return what a run's metrics say of a run beside it."""
    if not known:
        return None
    shared = {key: known[key] for key in SHARED}
    train = shared["train"]
    by_earlier_version = train and "total_epochs" not in train and train.get("init") == "random"
    if by_earlier_version:
        shared["train"] = with_totals(train, None)
    return shared


def publish(
    out: Path,
    metrics: Metrics,
    attacked: Mapping[str, Attacked],
    classes: Mapping[int, str],
    seconds: Mapping[str, float],
) -> Metrics:
    """Write report.html, then metrics.json, and print the summary. Returns the metrics with what
    was added.

    Args:
        attacked: name to model, for the pictures; the run's own comes first.
        seconds: spent, by phase.
    """
    own = next(iter(attacked.values()))
    runners = {name: one.runner for name, one in attacked.items()}
    metrics = metrics | {"time": dict(seconds)}
    shown = run_examples(runners, main_attack(own.tables[0]), classes)
    report.write_run(out / "report.html", metrics, shown)
    write_text(out / "metrics.json", json.dumps(metrics, indent=1))
    print(report.run_summary(metrics))
    print(f"Report: {out / 'report.html'}")
    return metrics


def publish_suite(
    out: Path,
    cfg: Config,
    suite: str,
    attacked: Attacked,
    protocol: Protocol,
    classes: Mapping[int, str],
    seconds: Mapping[str, float],
) -> Metrics:
    """Write report.html, tables.md, results.csv and metrics.json of a suite, and print its summary.

    Args:
        out: the folder that they go into. suite: its name. seconds: spent so far, by phase.
    """
    tables = {}
    for name, lines in attacked.lines.groupby("table", sort=False):
        known = lines.drop(columns="table").astype(object)
        tables[str(name)] = known.where(known.notna(), None).to_dict("records")
    metrics = {
        "suite": suite,
        "recipe": cfg.recipe,
        "seed": cfg.seed,
        "data": cfg.data.name,
        "model": cfg.model,
        "n": protocol.batches.n,
        "steps": protocol.settings.steps,
        "eps": protocol.config().middle,
        **attacked.checks,
        "tables": tables,
        "time": {**seconds, **attacked.seconds},
        **about(cfg),
    }
    name = cfg.model if cfg.recipe == "pretrained" else cfg.recipe
    shown = {}
    for table in attacked.tables:
        shown[table.name] = table_examples(table, attacked.runner, classes, name)
    text = report.write_suite(out, metrics, attacked.tables, attacked.lines, shown)
    write_text(out / "metrics.json", json.dumps(metrics, indent=1))
    print(text)
    print(f"Report: {out / 'report.html'}")
    return metrics
