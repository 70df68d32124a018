"""Suites: the tables that answer a question, each a short definition.

Rows and columns are laid out so that the controls stand beside the attack that they control: the
same shots without noise, and with noise of random sign.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from moireaug.common.argument_checks import one_of
from moireaug.evaluation.suites.adaptive import adaptive
from moireaug.evaluation.suites.appearance import appearance
from moireaug.evaluation.suites.demoireing import demoireing
from moireaug.evaluation.suites.ensembles import standard, worst_case
from moireaug.evaluation.suites.ladder import full_ladder, ladder
from moireaug.evaluation.suites.paper import (
    budget,
    defences,
    factors,
    jpeg,
    mean_normalised,
    noise_position,
    success,
    transfer,
)
from moireaug.evaluation.suites.scenes import threat, unseen
from moireaug.evaluation.suites.shifts import shifts
from moireaug.evaluation.suites.trust import trust
from moireaug.evaluation.tables import SuiteConfig, Table

SUITES: dict[str, Callable[[SuiteConfig], Table]] = {
    "ladder": ladder,
    "full_ladder": full_ladder,
    "success": success,
    "mean_normalised": mean_normalised,
    "jpeg": jpeg,
    "defences": defences,
    "demoireing": demoireing,
    "transfer": transfer,
    "budget": budget,
    "factors": factors,
    "noise_position": noise_position,
    "appearance": appearance,
    "threat": threat,
    "adaptive": adaptive,
    "standard": standard,
    "worst_case": worst_case,
    "unseen": unseen,
    "shifts": shifts,
    "trust": trust,
}
GROUPS: dict[str, tuple[str, ...]] = {
    "paper": (
        "success",
        "mean_normalised",
        "jpeg",
        "defences",
        "demoireing",
        "transfer",
        "budget",
        "factors",
        "noise_position",
        "appearance",
        "threat",
        "adaptive",
    ),
    "recipes": ("worst_case", "unseen"),
}
ATTACK_FREE_SUITES = ("threat", "unseen")
# options that only some suites use, and those suites
OPTION_SUITES: dict[str, tuple[str, ...]] = {
    "eps": (*(name for name in SUITES if name not in (*ATTACK_FREE_SUITES, "worst_case")), "paper"),
    "targets": ("transfer", "trust", "paper"),
    "defences": ("mean_normalised", "jpeg", "defences", "noise_position", "adaptive", "paper"),
    "networks": ("demoireing", "paper"),
    "lpips": tuple(name for name in (*SUITES, *GROUPS) if name not in ATTACK_FREE_SUITES),
}


def check_used(suite: str, option: str, suites: Sequence[str]) -> None:
    """Refuse an option that only other suites use, such as those of `OPTION_SUITES["targets"]`:
    ValueError."""
    if suite not in suites:
        raise ValueError(
            f"{option}= is for suite={' or '.join(suites)}; suite={suite} has no use for it."
        )


def tables_of(suite: str, config: SuiteConfig) -> list[Table]:
    """Return the tables of a suite, or of a group of them.

    Raises:
        ValueError: an unknown suite; the message lists the known ones.
    """
    one_of("suite", suite, (*SUITES, *GROUPS))
    return [SUITES[name](config) for name in GROUPS.get(suite, (suite,))]
