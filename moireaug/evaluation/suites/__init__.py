"""Suites: functions that lay out the tables which answer a question.

Rows and columns are laid out so that the controls stand beside the attack that they control: the
same shots without noise, and with noise of random sign.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from moireaug.common.argument_checks import one_of
from moireaug.evaluation.suites.ensembles import adaptive, standard, worst_case
from moireaug.evaluation.suites.ladder import full_ladder, ladder
from moireaug.evaluation.suites.scenes import unseen
from moireaug.evaluation.suites.trust import trust
from moireaug.evaluation.tables import SuiteConfig, Table

Config = TypeVar("Config", bound=SuiteConfig)
Suite = Callable[[Config], Table | Sequence[Table]]

SUITES: dict[str, Callable[[SuiteConfig], Table]] = {
    "ladder": ladder,
    "full_ladder": full_ladder,
    "adaptive": adaptive,
    "standard": standard,
    "worst_case": worst_case,
    "unseen": unseen,
    "trust": trust,
}
GROUPS: dict[str, tuple[str, ...]] = {"recipes": ("worst_case", "unseen")}
ATTACKING_SUITES = tuple(name for name in (*SUITES, *GROUPS) if name != "unseen")
# options that only some suites use, and those suites
OPTION_SUITES: dict[str, tuple[str, ...]] = {
    "eps": tuple(name for name in ATTACKING_SUITES if name not in ("worst_case", "recipes")),
    "targets": ("trust",),
    "defences": ("adaptive",),
    "lpips": ATTACKING_SUITES,
}


def check_used(suite: str, option: str, suites: Sequence[str]) -> None:
    """Refuse an option that only other suites use, such as those of `OPTION_SUITES["targets"]`:
    ValueError."""
    if suite not in suites:
        raise ValueError(
            f"{option}= is for suite={' or '.join(suites)}; suite={suite} has no use for it."
        )


def tables_of(suite: str | Suite[Config], config: Config) -> list[Table]:
    """Return the tables of a suite, or of a group of them.

    Args:
        suite: a key of `SUITES` or `GROUPS`, or a function of the config that returns a table, or
            several.
        config: settings of the tables.

    Raises:
        ValueError: an unknown name; the message lists the known ones. Two tables of one name.
        TypeError: a function that returns anything but tables.
    """
    if callable(suite):
        made = suite(config)
        tables = [made] if isinstance(made, Table) else made
        if not isinstance(tables, Sequence) or not all(isinstance(one, Table) for one in tables):
            raise TypeError(
                f"suite must return a moireaug.evaluation.Table, or a list of them; got {made!r}."
            )
        if len({table.name for table in tables}) < len(tables):
            raise ValueError(
                "a suite's tables must have different names; got "
                f"{', '.join(table.name for table in tables)}."
            )
        return list(tables)
    one_of("suite", suite, (*SUITES, *GROUPS))
    return [SUITES[name](config) for name in GROUPS.get(suite, (suite,))]


def suite_name(suite: str | Suite[SuiteConfig]) -> str:
    """Return the name of a suite in messages."""
    return suite if isinstance(suite, str) else getattr(suite, "__name__", type(suite).__name__)
