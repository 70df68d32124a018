"""What robustness costs: every run of a folder, attacked by suite=recipes, in one table and one plot.

    python training/fit.py -m recipe=clean,moire_at,pgd_at seed=0,1,2
    python training/reattack.py run=runs/moire_at/seed0 suite=recipes reattack.steps=50    # and so on, run by run
    python training/frontier.py runs

Writes frontier.md, frontier.csv (a line a run), frontier.json and frontier.png into runs/frontier/, or where out=DIR
says. A run that was not attacked yet is left out, and the command that attacks it is printed.
"""

from __future__ import annotations

import csv
import io
import json
import sys
import textwrap
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

from moireaug.evaluation.store import write_bytes, write_text
from moireaug.evaluation.words import percent
from training.frontier_plot import draw
from training.points import Found, Point, read
from training.summaries import RATES, Recipe, summarise


def caption(recipes: Sequence[Recipe], shared: dict) -> str:
    """What the figures are of, and what their intervals are."""
    n, many = shared["n"], [r for r in recipes if len(r.seeds) > 1]
    intervals = ["over seeds, on the same images (Student’s t)"] if many else []
    if len(many) < len(recipes):
        intervals.append(f"{'of a recipe with one seed ' if many else ''}of {n} images (Wilson)")
    said = [
        "Accuracy in % of {n} test images: {data}, {model}, scene {scene}, {steps} steps an attack.".format(**shared),
        f"Intervals of 95 %: {'; '.join(intervals)}.",
        "Worst case: each image at the worst of the photo alone and three Moiré Attacks.",
        "Time is of training alone, on top of the clean weights that a recipe starts from; × clean counts both.",
        "● no other recipe is as robust at 4/255 for less time.",
    ]
    lost = [f"{r.name} in {r.collapsed} of {len(r.seeds)} seeds" for r in recipes if r.collapsed]
    if lost:
        said.append(f"† training collapsed (catastrophic overfitting): {', '.join(lost)}.")
    return " ".join(said)


def markdown(recipes: Sequence[Recipe], found: Found) -> str:
    """The table, its caption, what to beware of, and the commands that would complete it."""
    times = ["training, s", "its start, s", "× clean", "passes an image", "images/s"]
    heads = ["recipe", "seeds", *RATES.values(), *times]
    lines = ["| " + " | ".join(heads) + " |", "|---|" + "---:|" * (len(heads) - 1)]
    for r in recipes:
        rates = [f"{percent(e.value)} <sub>{percent(e.low)}–{percent(e.high)}</sub>" for e in r.rates.values()]
        start = f"{r.start_seconds:.1f}" if r.start_seconds else "–"
        cost = [f"{r.seconds:.1f}", start, f"{r.relative.value:.2f}", f"{r.passes:.2f}", f"{r.images_per_second:.0f}"]
        lines.append("| " + " | ".join([_name(r), str(len(r.seeds)), *rates, *cost]) + " |")
    lines += ["", caption(recipes, found.shared), *(f"\n{text}" for text in found.warnings)]
    if found.commands:
        lines += ["", "Left out, because they were not attacked by suite=recipes in their own scene:", ""]
        lines += [f"    {command}" for command in found.commands]
    return "\n".join(["# What robustness costs", "", "![accuracy against training time](frontier.png)", "", *lines, ""])


def text(recipes: Sequence[Recipe], found: Found) -> str:
    """The same for the terminal, in at most 100 columns."""
    wide = min(26, max(len(_name(r)) for r in recipes))
    heads = {"clean": 6, "moiré": 7, "unseen": 8, "worst 4/255 [95 %]": 22, "8/255": 7, "PGD": 7, "× clean": 9}
    lines = [f"{'':{wide}} seeds " + "".join(f"{head:>{width}}" for head, width in heads.items())]
    for r in recipes:
        mean = {key: percent(e.value) for key, e in r.rates.items()}
        worst = r.rates["worst_4"]
        ends = f"{mean['worst_4']} [{percent(worst.low)}, {percent(worst.high)}]"
        cells = f"{mean['clean']:>6}{mean['natural']:>7}{mean['unseen_mean']:>8}{ends:>22}{mean['worst_8']:>7}"
        lines.append(f"{_name(r)[:wide]:{wide}} {len(r.seeds):>5} {cells}{mean['pgd_4']:>7}{r.relative.value:>9.2f}")
    lines += ["", *(textwrap.fill(words, 100) for words in (caption(recipes, found.shared), *found.warnings))]
    if found.commands:
        lines += ["", "Left out, because they were not attacked yet:", *(f"  {command}" for command in found.commands)]
    return "\n".join(lines)


def _name(r: Recipe) -> str:
    return f"{r.name}{' ●' if r.front else ''}{' †' if r.collapsed else ''}"


def to_csv(points: Sequence[Point]) -> str:
    """A line a run, with the fields of `Point` and its training with its start."""
    file = io.StringIO()
    writer = csv.DictWriter(file, [f.name for f in fields(Point)] + ["total_seconds"], lineterminator="\n")
    writer.writeheader()
    writer.writerows(asdict(p) | {"total_seconds": p.total_seconds} for p in points)
    return file.getvalue()


def frontier(root: Path, out: Path) -> list[Recipe]:
    """Gather, write and print; returns the recipes, cheapest first.

    Raises:
        ValueError: runs that are missing or do not compare.
    """
    found = read(root)
    recipes = summarise(found.points)
    write_bytes(out / "frontier.png", draw(recipes, found.shared))
    write_text(out / "frontier.csv", to_csv(found.points))
    write_text(out / "frontier.md", markdown(recipes, found))
    whole = found._asdict() | {"points": [asdict(p) for p in found.points], "recipes": [_plain(r) for r in recipes]}
    write_text(out / "frontier.json", json.dumps(whole | {"caption": caption(recipes, found.shared)}, indent=1))
    print(text(recipes, found))
    print(f"Written: {out / 'frontier.md'}")
    return recipes


def _plain(r: Recipe) -> dict:
    """A recipe as plain values, its estimates by name."""
    rates = {key: e._asdict() for key, e in r.rates.items()}
    return asdict(r) | {"rates": rates, "relative": r.relative._asdict()}


def main(argv: Sequence[str]) -> None:
    folders = [a for a in argv if not a.startswith("out=")]
    if len(folders) != 1 or len(argv) > 2:
        raise SystemExit("error: pass one folder of runs, as in: python training/frontier.py runs [out=DIR]")
    root = Path(folders[0])
    out = next((Path(a.removeprefix("out=")) for a in argv if a.startswith("out=")), root / "frontier")
    try:
        frontier(root, out)
    except (ValueError, OSError) as error:
        raise SystemExit(f"error: {error}") from None


if __name__ == "__main__":
    main(sys.argv[1:])
