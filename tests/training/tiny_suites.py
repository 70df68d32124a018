"""Suites run through the real command on six drawn signs, for the tests of it."""

from tests.training import small
from training import reattack

TINY = ["data.train=60", "data.val=16", "data.test=24", "data.size=24", "trainer.accelerator=cpu"]
TINY += ["reattack.n=6", "reattack.batch_size=3", "reattack.steps=1"]


def configured(*overrides):
    return small.configured(*TINY, *overrides, name="reattack")


def suite(name, weights, runs, *more):
    given = ["model=small_resnet", f"weights={weights}", f"suite={name}", f"runs={runs}", *more]
    return reattack.reattack(configured(*given), [])


def folder_of(runs, name, n=6):
    """Where a suite of n images wrote its report."""
    (found,) = (runs / "reattack/small_resnet").glob(f"signs-*-n{n}-steps1-*/{name}")
    return found


def record_files(runs):
    """The files of records, one for each command that wrote some."""
    return sorted((runs / "reattack/small_resnet/records").glob("records-*.jsonl"))


def cells(metrics):
    """Every figure but the times."""
    return {
        (name, r["row"], r["column"]): {k: v for k, v in r.items() if k != "seconds"}
        for name, rows in metrics["tables"].items()
        for r in rows
    }
