"""The application's suites: those of the library, and those that only the paper's tables and the
project's results need."""

from collections.abc import Callable

from moireaug.common.argument_checks import one_of
from moireaug.evaluation import suites as library
from moireaug.evaluation.tables import Table
from training.suites import paper
from training.suites.config import PaperConfig
from training.suites.shifts import shifts
from training.suites.threat_scenes import threat

PAPER_SUITES: dict[str, Callable[[PaperConfig], Table]] = {
    "success": paper.success,
    "mean_normalised": paper.mean_normalised,
    "jpeg": paper.jpeg,
    "defences": paper.defences,
    "demoireing": paper.demoireing,
    "transfer": paper.transfer,
    "budget": paper.budget,
    "factors": paper.factors,
    "noise_position": paper.noise_position,
    "appearance": paper.appearance,
    "threat": threat,
}
SUITES = library.SUITES | PAPER_SUITES | {"shifts": shifts}
GROUPS = library.GROUPS | {"paper": (*PAPER_SUITES, "adaptive")}
ATTACKING_PAPER_SUITES = tuple(name for name in PAPER_SUITES if name != "threat")
# options that only some suites use, and those suites
OPTION_SUITES: dict[str, tuple[str, ...]] = {
    "reattack.eps": (*library.OPTION_SUITES["eps"], *ATTACKING_PAPER_SUITES, "shifts", "paper"),
    "lpips": (*library.OPTION_SUITES["lpips"], *ATTACKING_PAPER_SUITES, "shifts", "paper"),
    "targets": ("transfer", "trust", "paper"),
    "networks": ("demoireing", "paper"),
    "demoire": ("defences", "demoireing", "paper"),
}


def tables_of(suite: str, config: PaperConfig) -> list[Table]:
    """Return the tables of a suite, or of a group of them.

    Raises:
        ValueError: an unknown suite; the message lists the known ones.
    """
    one_of("suite", suite, (*SUITES, *GROUPS))
    tables = []
    for name in GROUPS.get(suite, (suite,)):
        tables += library.tables_of(SUITES[name], config)
    return tables
