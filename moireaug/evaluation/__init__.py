"""Evaluation: models attacked again, with the controls that tell the moiré from the noise."""

from moireaug.evaluation.given import Given
from moireaug.evaluation.ladder import climb, ladder, middle
from moireaug.evaluation.rungs import Rung, no_moire
from moireaug.evaluation.statistics import mix, paired_gain, wilson
from moireaug.evaluation.suites import GROUPS, SUITES, tables_of
from moireaug.evaluation.sweep import Index, Job, Judge, Row, complete, gather, sweep
from moireaug.evaluation.table import Cell, Table

__all__ = [
    "GROUPS",
    "SUITES",
    "Cell",
    "Given",
    "Index",
    "Job",
    "Judge",
    "Row",
    "Rung",
    "Table",
    "climb",
    "complete",
    "gather",
    "ladder",
    "middle",
    "mix",
    "no_moire",
    "paired_gain",
    "sweep",
    "tables_of",
    "wilson",
]
