"""The paper's figures, beside those of an evaluation."""

from importlib import resources

import pandas as pd

from moireaug.evaluation.conditions import in_255ths
from moireaug.evaluation.frame import CELL_COLUMNS
from training.report.suite_tables import text_of

PAPER_BOUND = "4"  # in 1/255, of tables that compare at one


def with_paper(lines: pd.DataFrame, eps: float) -> pd.DataFrame:
    """Fill in the paper's figures of success rates; those of tables that compare at one bound, only
    where `eps` is the paper's."""
    published = read_published()
    if in_255ths(eps) != PAPER_BOUND:
        one_bound = published["table"].map(lambda table: text_of(table).one_bound)
        published = published[~one_bound]
    return lines.drop(columns="paper").merge(published, "left", on=CELL_COLUMNS)


def read_published() -> pd.DataFrame:
    """Return the paper's figures: success rates on Inception-V3, of 5000 ImageNet images that it
    classifies correctly.

    The paper's table 3 calls C&W an L-infinity and MI-FGSM an L2 attack; its text says the reverse,
    which is right for both."""
    path = resources.files("training.report").joinpath("published.csv")
    with path.open(encoding="utf-8") as file:
        return pd.read_csv(file)
