"""What robustness costs: every run of a folder, attacked with suite=recipes, in one table and plot.

    python training/fit.py -m recipe=baseline,moire_at,pgd_at seed=0,1,2
    python training/reattack.py run=runs/moire_at/seed0 suite=recipes reattack.steps=50
    python training/frontier.py runs    # when all runs are attacked

Writes frontier.md, frontier.csv (one line per run), frontier.json and frontier.png into
runs/frontier/, or where out=DIR says. A run that was not attacked yet is left out, and the command
that attacks it is printed.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __name__ == "__main__":  # search the repository, not this folder: a user has a models.py too
    sys.path[: not sys.flags.safe_path] = [str(Path(__file__).resolve().parents[1])]

import json
import textwrap
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import pandas as pd

from moireaug.evaluation.report.numbers import percent, points
from moireaug.evaluation.report.page import environment
from moireaug.evaluation.report.terminal import Grid, Part, show
from moireaug.files import write_bytes, write_text
from training.comparison.plot import draw
from training.comparison.points import Found, read
from training.comparison.summaries import Recipe, summarise
from training.system.messages import use_legible_output

WIDEST = 26  # characters of a recipe's name in the terminal
TEMPLATE = Path(__file__).parent / "comparison" / "frontier.md.j2"
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
    said = [
        f"Accuracy in % of {attacked.format(**shared)}.",
        intervals,
        "Worst case: each image at the worst of the photo, the Moiré Attack, APGD and APGD-T.",
        "Time is of training alone, by the median epoch, on top of the clean weights that a recipe "
        "starts from; × plain counts both, in those of plain training.",
        "● no other recipe is as robust at 4/255 for less time.",
    ]
    lost = [f"{r.name} in {r.collapsed} of {len(r.seeds)} seeds" for r in recipes if r.collapsed]
    if lost:
        said.append(f"† training collapsed (catastrophic overfitting): {', '.join(lost)}.")
    return " ".join(said)


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


def said(recipes: Sequence[Recipe], found: Found) -> list[Part]:
    """Return the same for the terminal, in at most 100 columns."""
    rows = [["", "seeds", *HEADS]]
    for recipe in recipes:
        worst = recipe.rates["worst_4"]
        row = [name_of(recipe, WIDEST), str(len(recipe.seeds))]
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


def name_of(recipe: Recipe, most: int | None = None) -> str:
    """Return a recipe's name with its marks: ● on the front, † collapsed.

    Args:
        most: characters, beyond which the name is cut off, but not its marks.
    """
    marks = f"{' ●' if recipe.front else ''}{' †' if recipe.collapsed else ''}"
    name = recipe.name if most is None else recipe.name[: most - len(marks)]
    return name + marks


def frontier(root: Path, out: Path) -> list[Recipe]:
    """Gather, write and print; returns the recipes, cheapest first.

    Raises:
        ValueError: runs that are missing or cannot be compared.
    """
    found = read(root)
    recipes = summarise(found.points)
    lines = [point.to_dict() for point in found.points]
    whole = {
        "points": lines,
        "shared": found.shared,
        "commands": found.commands,
        "warnings": found.warnings,
        "recipes": [_plain(recipe) for recipe in recipes],
        "caption": caption(recipes, found.shared),
    }
    write_bytes(out / "frontier.png", draw(recipes, found.shared))
    write_text(out / "frontier.csv", pd.DataFrame(lines).to_csv(index=False))
    write_text(out / "frontier.md", markdown(recipes, found))
    write_text(out / "frontier.json", json.dumps(whole, indent=1))
    show(said(recipes, found))
    print(f"Written: {out / 'frontier.md'}")
    return recipes


def _plain(recipe: Recipe) -> dict[str, Any]:
    """Return a recipe as plain values, its estimates by name."""
    plain = asdict(recipe)
    plain["relative"] = recipe.relative._asdict()
    for part in ("rates", "gains"):
        estimates = getattr(recipe, part)
        plain[part] = {name: estimate._asdict() for name, estimate in estimates.items()}
    return plain


def main(argv: Sequence[str]) -> None:
    """Run the command line, or exit with a one-line error."""
    use_legible_output()
    if {"-h", "--help"} & set(argv):
        print(__doc__ or f"Read {__file__}.")  # Python was told to leave docstrings out
        return
    folders = [a for a in argv if not a.startswith("out=")]
    if len(folders) != 1 or len(argv) > 2:
        raise SystemExit(
            "error: pass one folder of runs, as in: python training/frontier.py runs [out=DIR]"
        )
    root = Path(folders[0])
    out = root / "frontier"
    for argument in argv:
        if argument.startswith("out="):
            out = Path(argument.removeprefix("out="))
    try:
        frontier(root, out)
    except (ValueError, OSError) as error:
        raise SystemExit(f"error: {error}") from None


if __name__ == "__main__":
    main(sys.argv[1:])
