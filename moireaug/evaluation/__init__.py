"""Evaluation: attacks on models, with the controls that tell the moiré from the noise.

A suite lays out tables, whose cells are conditions before classifiers. A condition shows images,
attacked ones if it is an attacker; a classifier predicts their classes. The runner keeps both in a
record for each batch; `images_frame` makes a row per cell and image of the records, and `rates` a
row per cell of those.
"""

# ruff: noqa: E402  # a missing extra is named before it is imported

from moireaug.common.extras import drop_missing_backend, require

require("eval", "moireaug.evaluation")
drop_missing_backend()

from moireaug.evaluation.evaluate import evaluate
from moireaug.evaluation.frame import images_frame, rates
from moireaug.evaluation.statistics import paired_gain, wilson
from moireaug.evaluation.suites import GROUPS, SUITES, tables_of
from moireaug.evaluation.suites.trust import checks
from moireaug.evaluation.tables import Cell, SuiteConfig, Table

__all__ = [
    "GROUPS",
    "SUITES",
    "Cell",
    "SuiteConfig",
    "Table",
    "checks",
    "evaluate",
    "images_frame",
    "paired_gain",
    "rates",
    "tables_of",
    "wilson",
]
