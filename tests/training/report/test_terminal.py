"""What commands print: tables whose columns are aligned, in characters that the output has."""

import io
import sys

import pytest

from training.report.terminal import aligned
from training.system.messages import prepare_output

ROWS = [["shown", "a [b]"], ["[bold]x[/bold]", "1.0"], ["y", "−20.5"]]
PLAIN = """shown           a [b]
[bold]x[/bold]    1.0
y               −20.5"""


def test_columns_are_aligned():
    assert aligned(ROWS) == PLAIN


@pytest.mark.parametrize(
    ("encoding", "accented"), [("ascii", "Moire"), ("latin-1", "Moiré"), ("cp1252", "Moiré")]
)
def test_characters_that_an_output_lacks_are_replaced_legibly(encoding, accented, monkeypatch):
    output = io.TextIOWrapper(io.BytesIO(), encoding)
    monkeypatch.setattr(sys, "stdout", output)
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    prepare_output()
    table = aligned([["", "gain"], ["n\udce9 × 2", "−20.5"]])
    print("Moiré, ε and 图", "→ A title", table, sep="\n")
    output.flush()
    said, title, head, row = output.buffer.getvalue().decode(encoding).splitlines()
    assert (said, title) == (f"{accented}, e and ?", "> A title")
    assert row.replace("×", "x") == "n? x 2  -20.5" and len(head) == len(row)
