"""What commands print: tables whose columns are aligned, in characters that the output has."""

import io
import sys

import pytest

from training.report.terminal import Grid, show
from training.system.messages import prepare_output

GRID = Grid([["shown", "a [b]"], ["[bold]x[/bold]", "1.0"], ["y", "−20.5"]], "A title")
PLAIN = """A sentence with [brackets].
A title
shown           a [b]
[bold]x[/bold]    1.0
y               −20.5

The end.
"""


def test_columns_are_aligned(capsys):
    show(["A sentence with [brackets].", GRID, "", "The end."])
    assert capsys.readouterr().out == PLAIN


@pytest.mark.parametrize(
    ("encoding", "accented"), [("ascii", "Moire"), ("latin-1", "Moiré"), ("cp1252", "Moiré")]
)
def test_characters_that_an_output_lacks_are_replaced_legibly(encoding, accented, monkeypatch):
    output = io.TextIOWrapper(io.BytesIO(), encoding)
    monkeypatch.setattr(sys, "stdout", output)
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    prepare_output()
    show(["Moiré, ε and 图", Grid([["", "gain"], ["n\udce9 × 2", "−20.5"]], "→ A title")])
    output.flush()
    said, title, head, row = output.buffer.getvalue().decode(encoding).splitlines()
    assert (said, title) == (f"{accented}, e and ?", "> A title")
    assert row.replace("×", "x") == "n? x 2  -20.5" and len(head) == len(row)
