"""What commands print: tables with lines in a terminal, without them elsewhere."""

import io
import sys

import pytest

from training.report.terminal import Grid, plain, show

GRID = Grid([["shown", "a [b]"], ["[bold]x[/bold]", "1.0"], ["y", "−20.5"]], "A title", rule=1)
PARTS = ["A sentence with [brackets].", GRID, "", "The end."]
PLAIN = """A sentence with [brackets].
A title
shown           a [b]
[bold]x[/bold]    1.0
y               −20.5

The end."""


class Terminal(io.StringIO):
    def isatty(self):
        return True


def printed(parts, width, monkeypatch):
    """What a terminal of that width gets."""
    monkeypatch.setenv("COLUMNS", str(width))
    monkeypatch.setattr(sys, "stdout", terminal := Terminal())
    show(parts)
    return terminal.getvalue()


def test_where_there_is_no_terminal_the_text_is_plain(capsys):
    show(PARTS)
    assert capsys.readouterr().out == PLAIN + "\n"


def test_a_terminal_gets_a_table_with_a_line_below_its_rule(monkeypatch):
    line = "─" * 21
    sentence, title, head, first, second, *end = PLAIN.splitlines()
    lines = [sentence, title, line, head, line, first, line, second, line, *end]
    assert printed(PARTS, 80, monkeypatch).splitlines() == lines


def test_a_table_that_is_too_wide_for_its_terminal_stays_whole(monkeypatch):
    assert printed([GRID], 20, monkeypatch) == plain([GRID]) + "\n"


class NarrowTerminal(io.TextIOWrapper):
    """A terminal that has few characters."""

    def __init__(self, encoding, is_terminal):
        super().__init__(io.BytesIO(), encoding)
        self.is_terminal = is_terminal

    def isatty(self):
        return self.is_terminal

    def content(self):
        self.flush()
        return self.buffer.getvalue().decode(self.encoding)


@pytest.mark.parametrize("is_terminal", [True, False])
@pytest.mark.parametrize(
    ("encoding", "accented"), [("ascii", "Moire"), ("latin-1", "Moiré"), ("cp1252", "Moiré")]
)
def test_characters_that_a_terminal_lacks_are_replaced_legibly(
    encoding, accented, is_terminal, monkeypatch
):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr(sys, "stdout", terminal := NarrowTerminal(encoding, is_terminal))
    show(["Moiré, ε and 图", Grid([["", "gain"], ["n\udce9 × 2", "−20.5"]], "→ A title", rule=1)])
    shown = terminal.content()
    for words in (f"{accented}, eps and ?\n", "-> A title", "-20.5"):
        assert words in shown
    assert "n? x 2" in shown or "n? × 2" in shown
