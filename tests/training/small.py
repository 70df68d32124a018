"""What the tests of training share: settings that take seconds, the real command, and one run of it
in this process."""

import contextlib
import copy
import functools
import io
import os
import subprocess
import sys
import time

import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra

from tests.training.forked import ALONE, LONG, ROOT
from training import fit, reattack
from training.classifier.train import train_model
from training.config import hydra_commands
from training.config.schema import Config, ReattackConfig, as_config
from training.data.load import load
from training.data.splits import Splits
from training.runs.run import Run, baseline_of, start_of
from training.system.files import read_checkpoint

NO_DATA = Splits(None, None, None, {}, 0)
TINY = ["data.train=32", "data.val=16", "data.test=24", "data.size=24", "train.epochs=2"]
TINY += ["train.batch_size=16", "reattack.n=8", "reattack.batch_size=4", "reattack.steps=2"]
TINY += ["trainer.accelerator=cpu", "trainer.precision=32-true"]  # whatever the CPU multiplies fast
# after TINY, where the attack does not matter
BRIEF = ["reattack.n=4", "reattack.eps=[0.02]", "reattack.steps=1"]
MAINS = {"fit.py": (fit.main, Config), "reattack.py": (reattack.main, ReattackConfig)}


def command(script, *overrides, cwd):
    """Run a script as a user does, away from the repository, to its end."""
    return subprocess.run(
        [sys.executable, str(ROOT / "training" / script), *overrides],
        cwd=cwd,
        env=os.environ | ALONE,
        capture_output=True,
        text=True,
        timeout=LONG,
    )


def inside(script, *overrides, cwd):
    """Run a script's command line in this process, which has imported already what a command
    imports for seconds."""
    GlobalHydra.instance().clear()
    out, err, status = io.StringIO(), io.StringIO(), 0
    with (
        pytest.MonkeyPatch.context() as patch,
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        patch.setattr(sys, "argv", [str(ROOT / "training" / script), *overrides])
        patch.setattr(hydra_commands, "_failed_jobs", [])
        patch.chdir(cwd)
        try:
            hydra_commands.run(*MAINS[script])
        except SystemExit as end:
            status = end.code
            if isinstance(status, str):  # as the interpreter does
                print(status, file=sys.stderr)
                status = 1
    return subprocess.CompletedProcess([script, *overrides], status, out.getvalue(), err.getvalue())


def epoch(path):
    return read_checkpoint(path)["epoch"] if path.is_file() else -1


def wait(process, is_reached):
    """Wait until a running command has come as far as that."""
    deadline = time.monotonic() + LONG
    while not is_reached():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.02)


def configured(*overrides, name="fit"):
    """The typed settings of a command line, composed once for all folders of runs."""
    folders = [given for given in overrides if given.startswith(("run=", "runs="))]
    others = tuple(given for given in overrides if given not in folders)
    cfg = copy.deepcopy(_composed(others, name))
    for given in folders:
        key, _, path = given.partition("=")
        setattr(cfg, key, path)
    return cfg


@functools.cache
def _composed(overrides, name):
    GlobalHydra.instance().clear()
    # `initialize` reads the source of every caller in the stack, which takes longer than composing
    with initialize_config_dir(str(ROOT / "recipes"), version_base="1.3"):
        return as_config(compose(name, list(overrides)))


def start_config(cfg):
    run = start_of(Run(cfg))
    return run and run.config


def baseline_config(cfg):
    run = baseline_of(Run(cfg))
    return run and run.config


def train(cfg):
    """Train a run alone, without its start, baseline and re-attack: the run, and what it cost."""
    run = Run(cfg)
    run.prepare()
    return run, train_model(run, load(cfg.data))[1]


def same(one, other):
    """Whether two runs' folders hold the same weights, bit for bit."""
    for name in ("best.ckpt", "last.ckpt"):
        states = [torch.load(run / name, weights_only=True)["state_dict"] for run in (one, other)]
        if not all(torch.equal(value, states[1][key]) for key, value in states[0].items()):
            return False
    return True
