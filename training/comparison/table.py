"""The table of recipes: as a page, and for the terminal."""

import textwrap
from collections.abc import Sequence

from training.comparison.costs import TABLE_COSTS
from training.comparison.frame import RATES, RunTable
from training.comparison.summaries import RecipeSummary
from training.report.numbers import percent, points
from training.report.page import render
from training.report.terminal import aligned

TERMINAL_WIDTH = 100  # characters
MAX_NAME_WIDTH = 26  # characters of a recipe's name in the terminal


def caption(recipes: Sequence[RecipeSummary], table: RunTable) -> str:
    """Return the caption: the meaning of the figures and their intervals."""
    text = render("frontier_caption.j2", recipes=recipes, shared=table.shared)
    return " ".join(line for line in text.splitlines() if line)


def markdown(recipes: Sequence[RecipeSummary], table: RunTable, against: str) -> str:
    """Return the table, its caption, warnings, and the commands that would complete it.

    Args:
        against: recipe that gains are over.
    """
    return render(
        "frontier.md.j2",
        name_of=name_of,
        recipes=recipes,
        gained=[recipe for recipe in recipes if recipe.gains],
        rival=rival_text(against),
        titles={name: rate.title for name, rate in RATES.items()},
        costs=TABLE_COSTS,
        caption=caption(recipes, table),
        warnings=table.warnings,
        commands=table.commands,
    )


def terminal_parts(recipes: Sequence[RecipeSummary], table: RunTable, against: str) -> list[str]:
    """Return the same for the terminal, in at most 100 columns."""
    rows = [_terminal_row(recipe) for recipe in recipes]
    parts = [aligned([list(rows[0]), *(list(row.values()) for row in rows)]), ""]
    for text in (caption(recipes, table), *table.warnings):
        parts.append(textwrap.fill(text, TERMINAL_WIDTH))
    if any(recipe.gains for recipe in recipes):
        parts.append(f"Gain: at 4/255, over {rival_text(against)}, in points.")
    if table.commands:
        parts += ["", "Left out, because they were not attacked yet:"]
        parts += [f"  {command}" for command in table.commands]
    return parts


def _terminal_row(recipe: RecipeSummary) -> dict[str, str]:
    """Return the row of a recipe, by the heads of the columns."""
    rates = {name: percent(rate.value) for name, rate in recipe.rates.items()}
    worst = recipe.rates["worst_4"]
    return {
        "": name_of(recipe, MAX_NAME_WIDTH),
        "seeds": str(len(recipe.seeds)),
        "clean": rates["clean"],
        "photo": rates["natural"],
        "unseen": rates["unseen_mean"],
        "worst 4/255 [95 %]": f"{rates['worst_4']} [{percent(worst.low)}, {percent(worst.high)}]",
        "gain": points(recipe.gains["worst_4"].value) if recipe.gains else "",
        "8/255": rates["worst_8"],
        "PGD": rates["pgd_4"],
        "× plain": f"{recipe.relative_time.value:.2f}",
    }


def rival_text(against: str) -> str:
    """Return what gains are over, in words."""
    return "plain training of at least as many epochs" if against == "baseline" else against


def name_of(recipe: RecipeSummary, width: int | None = None) -> str:
    """Return a recipe's name with its marks: ● on the front, † collapsed.

    Args:
        width: width with the marks, in characters, to which the name is cut; None is any.
    """
    marks = " ●" if recipe.is_on_front else ""
    if recipe.collapsed_count:
        marks += " †"
    name = recipe.name if width is None else recipe.name[: width - len(marks)]
    return name + marks
