"""The paper's figures, beside those of an evaluation."""

from collections.abc import Sequence
from importlib import resources

import pandas as pd

from moireaug.evaluation.frame import CELL_COLUMNS
from moireaug.evaluation.tables import Table


def with_paper(lines: pd.DataFrame, tables: Sequence[Table]) -> pd.DataFrame:
    """Fill in the paper's figures, where a table's cells are at the paper's bound."""
    own_tables = {table.name for table in tables if table.published}
    published = read_published()
    published = published[published["table"].isin(own_tables)]
    return lines.drop(columns="paper").merge(published, "left", on=CELL_COLUMNS)


def read_published() -> pd.DataFrame:
    """Return the paper's figures: success rates on Inception-V3, of 5000 ImageNet images that it
    classifies correctly.

    The paper's table 3 calls C&W an L-infinity and MI-FGSM an L2 attack; its text says the reverse,
    which is right for both."""
    path = resources.files("training.report").joinpath("published.csv")
    with path.open(encoding="utf-8") as file:
        return pd.read_csv(file)
