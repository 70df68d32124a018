"""Suites run through the real command on six drawn signs, for the tests of it."""

from hydra import compose, initialize
from hydra.core.global_hydra import GlobalHydra

from training import reattack
from training.config.schema import as_config

TINY = [
    "data.train=60",
    "data.val=16",
    "data.test=24",
    "data.size=24",
    "reattack.n=6",
    "reattack.batch_size=3",
    "reattack.steps=1",
    "trainer.accelerator=cpu",
]


def configured(*overrides):
    GlobalHydra.instance().clear()
    with initialize(version_base="1.3", config_path=None):
        return as_config(compose("reattack", [*TINY, *overrides]))


def suite(name, weights, runs, *more):
    cfg = configured(
        "model=small_resnet", f"weights={weights}", f"suite={name}", f"runs={runs}", *more
    )
    return reattack.reattack(cfg, [])


def folder_of(runs, name, n=6):
    """Where a suite of n images wrote its report."""
    (found,) = (runs / "reattack/small_resnet").glob(f"signs-*-n{n}-steps1-*/{name}")
    return found


def records_of(runs):
    """The one file of records."""
    (found,) = (runs / "reattack/small_resnet/records").glob("records-*.jsonl")
    return found


def cells(metrics):
    """Every figure but the times."""
    return {
        (name, r["row"], r["column"]): {k: v for k, v in r.items() if k != "seconds"}
        for name, rows in metrics["tables"].items()
        for r in rows
    }
