"""The table of recipes: as a page, for the terminal, and as plain values."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from moireaug.evaluation.report.numbers import percent, points
from moireaug.evaluation.report.page import environment
from moireaug.evaluation.report.terminal import Grid, Part
from training.comparison.points import Found
from training.comparison.summaries import Recipe

MAX_NAME_WIDTH = 26  # characters of a recipe's name in the terminal
TEMPLATE = Path(__file__).with_name("frontier.md.j2")
TITLES = {
    "clean": "clean",
    "natural": "natural moiré",
    "unseen_mean": "unseen scenes, mean",
    "unseen_worst": "unseen scenes, worst",
    "worst_4": "worst case 4/255",
    "worst_8": "worst case 8/255",
    "pgd_4": "PGD 4/255, no camera",
}
HEADS = ("clean", "moiré", "unseen", "worst 4/255 [95 %]", "gain", "8/255", "PGD", "× plain")


def caption(recipes: Sequence[Recipe], shared: dict[str, Any]) -> str:
    """Return the caption: what the figures and their intervals mean."""
    intervals = "95 % intervals cover the choice of seeds and of images (two-way bootstrap)."
    if any(len(recipe.seeds) == 1 for recipe in recipes):
        intervals += " Those of a single seed cover the choice of images alone."
    attacked = "{n} test images: {data}, {model}, scene {scene}, {steps} steps per attack"
    sentences = [
        f"Accuracy in % of {attacked.format(**shared)}.",
        intervals,
        "Worst case: each image at the worst of the photo, the Moiré Attack, APGD and APGD-T.",
        "Time is of training alone, by the median epoch, on top of the clean weights that a recipe "
        "starts from; × plain counts both, in those of plain training.",
        "● no other recipe is as robust at 4/255 for less time.",
    ]
    lost = [f"{r.name} in {r.collapsed} of {len(r.seeds)} seeds" for r in recipes if r.collapsed]
    if lost:
        sentences.append(f"† training collapsed (catastrophic overfitting): {', '.join(lost)}.")
    return " ".join(sentences)


def markdown(recipes: Sequence[Recipe], found: Found) -> str:
    """Return the table, its caption, warnings, and the commands that would complete it."""
    return (
        environment()
        .from_string(TEMPLATE.read_text("utf-8"))
        .render(
            name_of=name_of,
            recipes=recipes,
            gained=[recipe for recipe in recipes if recipe.gains],
            titles=TITLES,
            caption=caption(recipes, found.shared),
            warnings=found.warnings,
            commands=found.commands,
        )
    )


def terminal_parts(recipes: Sequence[Recipe], found: Found) -> list[Part]:
    """Return the same for the terminal, in at most 100 columns."""
    rows = [["", "seeds", *HEADS]]
    for recipe in recipes:
        worst = recipe.rates["worst_4"]
        row = [name_of(recipe, MAX_NAME_WIDTH), str(len(recipe.seeds))]
        for name in ("clean", "natural", "unseen_mean"):
            row.append(percent(recipe.rates[name].value))
        row.append(f"{percent(worst.value)} [{percent(worst.low)}, {percent(worst.high)}]")
        row.append(points(recipe.gains["worst_4"].value) if recipe.gains else "")
        for name in ("worst_8", "pgd_4"):
            row.append(percent(recipe.rates[name].value))
        row.append(f"{recipe.relative.value:.2f}")
        rows.append(row)
    parts: list[Part] = [Grid(rows), ""]
    for words in (caption(recipes, found.shared), *found.warnings):
        parts.append(textwrap.fill(words, 100))
    if any(recipe.gains for recipe in recipes):
        parts.append("Gain: at 4/255, over plain training of at least as many epochs, in points.")
    if found.commands:
        parts += ["", "Left out, because they were not attacked yet:"]
        parts += [f"  {command}" for command in found.commands]
    return parts


def name_of(recipe: Recipe, width: int | None = None) -> str:
    """Return a recipe's name with its marks: ● on the front, † collapsed.

    Args:
        width: characters, beyond which the name is cut off, but not its marks.
    """
    marks = f"{' ●' if recipe.front else ''}{' †' if recipe.collapsed else ''}"
    name = recipe.name if width is None else recipe.name[: width - len(marks)]
    return name + marks


def plain_values(recipe: Recipe) -> dict[str, Any]:
    """Return a recipe as plain values, its estimates by name."""
    plain = asdict(recipe)
    plain["relative"] = recipe.relative._asdict()
    for part in ("rates", "gains"):
        estimates = getattr(recipe, part)
        plain[part] = {name: estimate._asdict() for name, estimate in estimates.items()}
    return plain
