"""The tables of an evaluation: the condition and the classifier of each cell."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from moireaug.attacks.checks import check_eps
from moireaug.defenses import DEFENSES
from moireaug.evaluation.attackers import Attacker
from moireaug.evaluation.classifiers import UNDEFENDED, Classifier, averaging_classifier
from moireaug.evaluation.conditions import Condition, ImageTransform, Model, Photo, in_255ths
from moireaug.mixtures import Mixture, as_scenes
from moireaug.scenes import Scene


@dataclass(frozen=True)
class Cell:
    """A condition before a classifier; or several, pooled or, with `worst`, the worst of them for
    each image."""

    row: str
    column: str
    conditions: tuple[Condition, ...]
    classifier: Classifier = UNDEFENDED
    worst: bool = False

    def __post_init__(self) -> None:
        given = self.conditions
        is_sequence = isinstance(given, (tuple, list)) and len(given) > 0
        if not (is_sequence and all(isinstance(one, Condition) for one in given)):
            raise TypeError(
                f"the cell {self.place} takes a tuple of one or more conditions, as in (Photo(),); "
                f"got {given!r}."
            )
        if not isinstance(self.classifier, Classifier):
            raise TypeError(
                f"the cell {self.place} takes a Classifier, as in Classifier('other', model=...); "
                f"got {type(self.classifier).__name__}."
            )

    @property
    def place(self) -> tuple[str, str]:
        """Row and column."""
        return self.row, self.column


@dataclass(frozen=True)
class Table:
    """A table of success rates.

    Args:
        name: name of its suite.
        cells: cells in the order of their rows and columns; a missing one stays empty.
    """

    name: str
    cells: tuple[Cell, ...]

    @property
    def rows(self) -> list[str]:
        """Names of the rows, in order."""
        return list(dict.fromkeys(cell.row for cell in self.cells))

    @property
    def columns(self) -> list[str]:
        """Names of the columns, in order."""
        return list(dict.fromkeys(cell.column for cell in self.cells))

    def __post_init__(self) -> None:
        places = [cell.place for cell in self.cells]
        for place in places:
            if places.count(place) > 1:
                raise ValueError(
                    f"table {self.name!r} has two cells of the row and column {place}. Give one "
                    "another row, or put the conditions of both into one cell."
                )

    def cell(self, row: str, column: str) -> Cell | None:
        """Return the cell of that row and column, or None."""
        for cell in self.cells:
            if cell.place == (row, column):
                return cell
        return None


DEFAULT_EPS = (2 / 255, 4 / 255, 8 / 255)  # unless a suite has its own
# names of the rows and columns that the attacked model has
RESERVED_NAMES = ("model", "undefended", "attacked", "as_it_is", "restored", "rounded")


def check_names(names: Sequence[str]) -> None:
    """Refuse names of targets and defences that are reserved, or given twice: ValueError."""
    for name in names:
        if name in RESERVED_NAMES or names.count(name) > 1:
            raise ValueError(
                f"{name!r} cannot name a target or a defence: it names another already, or is one "
                f"of {', '.join(RESERVED_NAMES)}. Choose another."
            )


def paper_defences() -> dict[str, ImageTransform]:
    """Return the paper's defences by name, except image quilting, which needs a bank of patches."""
    return {name: make() for name, make in DEFENSES.items()}


@dataclass(frozen=True, kw_only=True)
class SuiteConfig:
    """The settings of a suite's tables.

    Args:
        scene: scene of the evaluation, or a mixture of scenes; also what `as_scenes` takes, such
            as a preset's name.
        shrink: images are crops, in every scene of a suite; see `Scene.with_shrink`. None leaves
            the scenes as they are.
        eps: bounds of the noise, in [0, 1] units, or one alone. A suite that compares at one bound
            takes the middle one. None leaves each suite its own.
        steps: gradient steps of every attack.
        targets: name to model for transfer; None where its weights are missing.
        defences: name to defence: by default the paper's.

    Raises:
        ValueError: bounds that are none, repeated or not in [0, 1], or names that are taken.
    """

    scene: Scene | Mixture
    shrink: float | Sequence[float] | None = None
    eps: tuple[float, ...] | None = None
    steps: int = 20
    targets: Mapping[str, Model | None] = field(default_factory=dict)
    defences: Mapping[str, ImageTransform] = field(default_factory=paper_defences)

    def __post_init__(self) -> None:
        object.__setattr__(self, "scene", as_scenes(self.scene, self.shrink))
        if self.eps is not None:
            bounds = np.atleast_1d(self.eps).tolist()
            for eps in bounds:
                check_eps(eps)
            object.__setattr__(self, "eps", tuple(map(_exact, bounds)))
            if not self.eps or len(set(self.eps)) < len(self.eps):
                raise ValueError(
                    f"eps must be one or more different bounds, in [0, 1] units; got {self.eps!r}."
                )
        check_names([*self.targets, *self.defences])

    @property
    def middle(self) -> float:
        """The middle bound, which tables compare at."""
        eps = self.bounds(DEFAULT_EPS)
        return eps[len(eps) // 2]

    def bounds(self, default: tuple[float, ...]) -> tuple[float, ...]:
        """Return the given bounds in order, or `default` where there are none."""
        return default if self.eps is None else tuple(sorted(self.eps))

    def behind(self, name: str, *, averages: bool = False) -> Classifier:
        """Return the attacked model behind the defence of that name; with `averages`, by the mean
        of its draws, see `averaging_classifier`.

        Raises:
            ValueError: there is no defence of that name.
        """
        if name not in self.defences:
            raise ValueError(
                f"the suite needs the defence {name!r}, which is missing. Pass "
                "SuiteConfig(defences=moireaug.evaluation.tables.paper_defences() | {...}), with "
                "your own in the braces."
            )
        defence = self.defences[name]
        return averaging_classifier(name, defence) if averages else Classifier(name, defence)


def _exact(eps: float) -> float:
    """Return a bound that was rounded to float32 as whole codes of 255, so that all suites share
    it."""
    whole = round(255 * eps)
    return whole / 255 if math.isclose(255 * eps, whole, rel_tol=1e-6) else eps


def cross(rows: Mapping[str, Classifier], columns: Mapping[str, Condition]) -> list[Cell]:
    """Return a cell of every condition before every classifier."""
    cells = []
    for row, classifier in rows.items():
        for column, condition in columns.items():
            cells.append(Cell(row, column, (condition,), classifier))
    return cells


def eps_row(eps: float) -> str:
    """Return the name of a bound's row."""
    return f"eps_{in_255ths(eps)}"


def undefended_row(row: str, columns: Mapping[str, Condition]) -> list[Cell]:
    """Return a row of conditions before the model itself."""
    return cross({row: UNDEFENDED}, columns)


def worst_of(cells: Iterable[Cell], row: str, eps: float, column: str = "worst") -> Cell:
    """Return the cell of the worst case: an image counts as right only if the cells' classifier
    gets it right under every condition of theirs that counts, see `is_in_worst_case`."""
    conditions: dict[str, Condition] = {}
    classifier = UNDEFENDED
    for cell in cells:
        for condition in cell.conditions:
            if is_in_worst_case(condition, eps):
                conditions[condition.name] = condition
                classifier = cell.classifier
    return Cell(row, column, tuple(conditions.values()), classifier, worst=True)


def is_in_worst_case(condition: Condition, eps: float) -> bool:
    """Return whether a condition counts in the worst case at a bound: the photo alone, and every
    attack through the camera that stays within that bound, whatever its target. Random noise, and
    attacks on pixels, do not."""
    if isinstance(condition, Attacker):
        return condition.on_screen and condition.eps <= eps
    return isinstance(condition, Photo)
