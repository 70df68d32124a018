"""How tests run a benchmark."""

import json
import runpy
import sys
from pathlib import Path

import pandas as pd
import pytest

ROOT = Path(__file__).resolve().parents[2]
QUICKLY = ["--quick", "--threads", "1", "--out", "."]


@pytest.fixture
def ran(tmp_path, monkeypatch, capsys):
    """Run a script in this process: what it printed, and what it wrote."""

    def run(name):
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", [f"{name}.py", *QUICKLY])
        runpy.run_path(str(ROOT / f"benchmarks/{name}.py"), run_name="__main__")
        file = tmp_path / f"{name}.json"
        written = json.loads(file.read_text()) if file.exists() else pd.read_csv(f"{name}.csv")
        return capsys.readouterr().out, written

    return run
