"""Compare two results of benchmarks/speed.py, such as the last release's and today's.

    python benchmarks/compare.py OLD.json NEW.json

Prints the rows that both have and that are measured against another library on the same machine,
by how many times our share of its time has grown. Exits with 1 if a row's has grown by more than
`MAX_GROWTH`.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pandas as pd

MAX_GROWTH = 1.5  # times; shared machines differ by a third from run to run


def ratios(path: Path) -> pd.Series:
    """Return the ratio of each row of a result to what it is measured against, by its name."""
    rows = pd.DataFrame(json.loads(path.read_text(encoding="utf-8"))["rows"])
    return rows.set_index(["what", "against"])["ratio"].dropna()


def compare(old: Path, new: Path) -> pd.DataFrame:
    """Return the rows of both results: ratios, and by how many times they have grown."""
    both = pd.concat({"old": ratios(old), "new": ratios(new)}, axis=1, join="inner")
    return both.assign(growth=both["new"] / both["old"])


def main(old: str, new: str) -> int:
    table = compare(Path(old), Path(new))
    if table.empty:
        print("no row is in both results")
        return 1
    print(table.round(2).to_string())
    return int((table["growth"] > MAX_GROWTH).any())


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
