"""Where commands import from: the repository, not their own folder, whose modules have names that a
user's have too; and what a user names, from the working folder."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.training.forked import Command
from tests.training.tiny_suites import TINY, folder_of

ROOT = Path(__file__).resolve().parents[2]
COMMANDS = ("fit", "reattack", "frontier", "synthesise", "calibrate", "demoire", "detect")

# a sitecustomize.py: ends a command at its first import from outside Python's own library
STOP = r"""
import os, sys

class Stop:
    def find_spec(self, name, *rest):
        if name.split(".")[0] not in sys.stdlib_module_names:
            print(*sys.path[:2], sep="\n", flush=True)
            os._exit(0)

sys.meta_path.insert(0, Stop())
"""


@pytest.mark.parametrize(
    ("command", "flags"), [*((command, ()) for command in COMMANDS), ("fit", ("-P",))]
)
def test_a_command_searches_the_repository_instead_of_its_own_folder(command, flags, tmp_path):
    (tmp_path / "sitecustomize.py").write_text(STOP)
    script = [sys.executable, *flags, str(ROOT / f"training/{command}.py")]
    env = os.environ | {"PYTHONPATH": str(tmp_path)}
    done = subprocess.run(
        script, cwd=tmp_path, env=env, capture_output=True, text=True, timeout=120
    )
    assert done.stdout.splitlines() == [str(ROOT), str(tmp_path)], done


MODELS = """
def clean(images):
    import data  # once it is called
    return data.same(images)
clean.identity = "the same"
"""
DATA = "def same(images):\n    return images\n"


def test_a_users_own_network_is_imported_from_the_working_folder(weights, tmp_path):
    """Although modules of the commands have the names of its modules."""
    (tmp_path / "models.py").write_text(MODELS)
    (tmp_path / "data.py").write_text(DATA)
    given = [f"weights={weights}", "suite=demoireing", "demoire=models:clean", "reattack.n=1"]
    process = Command("reattack.py", "model=small_resnet", *TINY, *given, cwd=tmp_path)
    _, err = process.communicate()
    assert process.returncode == 0, err
    metrics = folder_of(tmp_path / "runs", "demoireing", n=1) / "metrics.json"
    rows = json.loads(metrics.read_text())["tables"]["demoireing"]
    assert {row["row"] for row in rows} == {"undefended", "models:clean"}
