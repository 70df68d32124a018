"""Paths on a command line are taken as they are, whatever Hydra's grammar makes of them."""

from pathlib import Path

import pytest

from tests.training.small import configured
from training import demoire, settings
from training.command_line import quoted

PLAIN = ("2024_11", "1e5", "true", "josé", "Photos (1)", "it's", "a=b", "a&b", "#1", "a;b", "!")
PLAIN += ("a,b", "{a}", "[a", "a:b", "runs/moire_at", "a b", " a ")
OTHERS = {"'a,b'": "a,b", r"a\,b": "a,b", "null": None, "~/a": str(Path.home() / "a")}
PATHS = dict(zip(PLAIN, PLAIN, strict=True)) | OTHERS


@pytest.mark.parametrize("given", PATHS)
def test_a_path_comes_through_hydras_grammar(given):
    override = quoted([f"data.root={given}"])
    assert quoted(override) == override, "further processes of a run get it again"
    assert configured("recipe=clean", *override).data.root == PATHS[given]


def test_a_sweep_of_paths_stays_one():
    sweep = ["weights=a.pt,b.pt", "runs=runs/${seed}", "-m"]
    assert quoted(sweep) == sweep
    assert quoted(["runs=2024_11", *sweep])[0] == "runs='2024_11'"


def test_the_scripts_expand_a_home_too():
    cfg = settings.parse(["in=~/a", "out=b", "weights=c"], demoire.Config, "", "")
    assert (cfg.in_, cfg.out) == (str(Path.home() / "a"), "b")
