"""Evaluation: models attacked again, with the controls that tell the moiré from the noise."""

from moireaug.evaluation.ladder import Row, Rung, climb, ladder, middle, no_moire
from moireaug.evaluation.statistics import mix, paired_gain, wilson

__all__ = ["Row", "Rung", "climb", "ladder", "middle", "mix", "no_moire", "paired_gain", "wilson"]
