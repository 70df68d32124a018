"""The workflows, which nothing runs here: they are YAML, their actions are pinned, and the oldest
versions are pyproject.toml's."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
PINNED = re.compile(r"[\w.-]+/[\w.-]+@[0-9a-f]{40}")


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_actions_are_pinned_to_a_commit(path):
    jobs = yaml.safe_load(path.read_text("utf-8"))["jobs"]
    actions = [job["uses"] for job in jobs.values() if "uses" in job]
    for job in jobs.values():
        actions += [step["uses"] for step in job.get("steps", ()) if "uses" in step]
    assert actions
    for action in actions:
        assert PINNED.fullmatch(action) or (ROOT / action).is_file(), action


def test_a_release_is_of_a_tested_commit_on_main():
    test, release = (
        yaml.safe_load((ROOT / f".github/workflows/{name}.yml").read_text("utf-8"))
        for name in ("test", "release")
    )
    publish = release["jobs"]["publish"]
    assert release["jobs"][publish["needs"]]["uses"] == "./.github/workflows/test.yml"
    assert "workflow_call" in test[True]  # YAML's "on"
    assert test["jobs"]["package"]["uses"] == "./.github/workflows/package.yml"
    assert any("merge-base --is-ancestor" in step.get("run", "") for step in publish["steps"])
    assert (
        "pull_request" in test["concurrency"]["group"]
    )  # commits on main have groups of their own


def test_the_oldest_versions_are_those_declared():
    command = [sys.executable, ".github/oldest.py"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60, check=True)
    constraints = done.stdout.splitlines()
    assert {"torch==2.9.*", "kornia==0.9.*", "albumentations==2.0.8.*"} <= set(constraints)
    assert len(set(constraints)) == len(constraints)
