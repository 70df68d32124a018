"""What robustness costs: every run of a folder, attacked with suite=recipes, in one table and plot.

    python training/fit.py -m recipe=baseline,moire_at,pgd_at seed=0,1,2 'shrink=[1,3]'
    python training/reattack.py run=runs/moire_at/seed0 suite=recipes reattack.steps=50
    python training/frontier.py runs    # when all runs are attacked
    python training/frontier.py runs against=pgd_at    # gains over this recipe, not over baseline
    python training/frontier.py runs/frontier/frontier.csv out=DIR    # again, from its CSV

Writes frontier.md, frontier.csv (one line per run, with the outcome of each image) and frontier.png
into runs/frontier/, or where out=DIR says, which a CSV needs. A run that was not attacked yet is
left out, and the command that attacks it is printed. Lines of several CSVs make one table.
"""

import sys
from pathlib import Path

if __name__ == "__main__":  # search the repository, not this folder: a user has a models.py too
    sys.path[: not sys.flags.safe_path] = [str(Path(__file__).resolve().parents[1])]

from collections.abc import Sequence
from dataclasses import dataclass

from omegaconf import MISSING

from moireaug.common.files import write_bytes, write_text
from training.comparison.csv_file import read_csv, to_csv
from training.comparison.frame import read
from training.comparison.plot import draw
from training.comparison.summaries import RecipeSummary, summarise
from training.comparison.table import markdown, terminal_parts
from training.config.plain_commands import parse, report_errors
from training.config.settings import setting
from training.runs.layout import FRONTIER

EXAMPLE = "python training/frontier.py runs"


@dataclass
class Config:
    """All settings of the command."""

    runs: str = setting(MISSING, "folder of runs, or frontier.csv; the prefix runs= is optional")
    against: str = setting("baseline", "recipe that the others are compared with")
    out: str | None = setting(None, "folder of the table; null: frontier/ in runs")


def frontier(source: Path, out: Path, against: str = "baseline") -> list[RecipeSummary]:
    """Read a folder of runs, or the CSV of such tables, and write and print its table; return the
    recipes, cheapest first.

    Args:
        against: recipe that gains are over.
    """
    table = read_csv(source) if source.suffix == ".csv" else read(source)
    recipes = summarise(table.runs, against)
    write_bytes(out / "frontier.png", draw(recipes, table.shared))
    write_text(out / "frontier.csv", to_csv(table))
    write_text(out / "frontier.md", markdown(recipes, table, against))
    print(*terminal_parts(recipes, table, against), sep="\n")
    print(f"Written: {out / 'frontier.md'}")
    return recipes


def main(argv: Sequence[str]) -> None:
    """Run the command line, or exit with a one-line error."""
    with report_errors("Interrupted before the table was written."):
        folders = [word for word in argv if "=" not in word and not word.startswith("-")]
        if len(folders) > 1:
            raise ValueError(f"pass one folder of runs, as in: {EXAMPLE}; got {len(folders)}.")
        named = [f"runs={word}" if word in folders else word for word in argv]
        cfg = parse(named, Config, EXAMPLE, __doc__)
        source = Path(cfg.runs)
        if source.suffix == ".csv" and cfg.out is None:  # beside it lie the tables of the runs
            raise ValueError("say where to write the table of a CSV, with out=DIR")
        frontier(source, Path(cfg.out) if cfg.out else source / FRONTIER, cfg.against)


if __name__ == "__main__":
    main(sys.argv[1:])
