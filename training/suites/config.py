"""The settings of the application's suites."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from moireaug.evaluation.conditions import ImageTransform
from moireaug.evaluation.tables import SuiteConfig, Table, check_names


@dataclass(frozen=True)
class PaperTable(Table):
    """A table that has rows without figures.

    Args:
        empty: reason of each of them.
    """

    empty: Mapping[str, str] = field(default_factory=dict)

    @property
    def rows(self) -> list[str]:
        return [*super().rows, *self.empty]


@dataclass(frozen=True, kw_only=True)
class PaperConfig(SuiteConfig):
    """The settings of a suite's tables, with those that only the paper's need.

    Args:
        networks: name to demoiréing network, as a defence.
        without: name of a missing defence to the reason.

    Raises:
        ValueError: as of `SuiteConfig`; names of networks that are taken.
    """

    networks: Mapping[str, ImageTransform] = field(default_factory=dict)
    without: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_names([*self.targets, *self.defences, *self.networks])
