"""Commands start without what they may not need, one process speaks, and sweeps outlive a failed
job."""

import contextlib
import io
import logging
import os
import subprocess
import sys

import pytest
import torch
from hydra.core.global_hydra import GlobalHydra
from tqdm import tqdm

from tests.training.forked import ROOT
from tests.training.small import TINY, configured, inside
from training import calibrate, demoire, fit, frontier, synthesise
from training.config import hydra_commands, plain_commands
from training.config.schema import Config
from training.demoireing import fit as demoireing
from training.demoireing.fit import DemoireingTask
from training.recipe.phases import ClassificationTask
from training.runs.run import Run
from training.system import machine, messages, processes

pytestmark = pytest.mark.usefixtures("as_the_command_is")

WATCH = """
import os, runpy, sys

class Watch:
    def find_spec(self, name, *given):
        if name == "torch":
            sys.exit(os.environ.get("GOMP_SPINCOUNT"))

sys.meta_path.insert(0, Watch())
del sys.argv[0]  # as the script itself has it
runpy.run_path(sys.argv[0], run_name="imported")
"""


@pytest.mark.parametrize(
    ("command", "given", "expected"), [("fit", "77", "77"), ("reattack", None, "10000")]
)
def test_how_threads_wait_is_set_before_torch_is_loaded(command, given, expected):
    env = {k: v for k, v in os.environ.items() if k != "GOMP_SPINCOUNT"}
    env |= {"GOMP_SPINCOUNT": given} if given else {}
    script = [sys.executable, "-c", WATCH, str(ROOT / f"training/{command}.py")]
    done = subprocess.run(script, env=env, capture_output=True, text=True)
    assert done.stderr == f"{expected}\n"


def test_a_program_that_imports_a_room_stays_as_it_is():
    lines = ["import gc, os, training.runs.trained"]
    lines += ["print(gc.get_freeze_count(), os.environ.get('GOMP_SPINCOUNT'))"]
    env = {k: v for k, v in os.environ.items() if k != "GOMP_SPINCOUNT"}
    script = [sys.executable, "-c", "\n".join(lines)]
    done = subprocess.run(script, env=env, capture_output=True, text=True)
    assert done.stdout == "0 None\n", done.stderr


# in one process, so those that import least come first
LIGHT = [
    ("training.demoire", ("torchvision", "lightning", "pandas", "matplotlib")),
    ("training.synthesise", ("torchvision", "lightning", "pandas", "matplotlib")),
    ("moireaug.evaluation", ("torchvision", "lightning", "matplotlib")),
    ("training.frontier", ("torchvision", "lightning")),
    ("training.calibrate", ("torchvision", "lightning", "cma")),
    ("training.fit", ("torchvision", "lightning")),
]


def test_no_command_waits_for_what_it_may_not_need():
    """Lightning and torchvision take seconds to import: a mistake is found, and a help printed,
    without them. The help may be cut short."""
    lines = ["import importlib.util, runpy, sys"]
    for module, absent in LIGHT:
        lines.append(f"import {module}")
        for name in absent:
            lines.append(f"assert {name!r} not in sys.modules, {module!r}")
            lines.append(f"assert importlib.util.find_spec({name!r})")  # that is its name
    script = str(ROOT / "training/fit.py")
    lines += [f"sys.argv = [{script!r}, '--help']", f"runpy.run_path({script!r}, None, '__main__')"]
    reader, writer = os.pipe()
    os.close(reader)
    program = [sys.executable, "-c", "\n".join(lines)]
    done = subprocess.run(program, cwd=ROOT, stdout=writer, stderr=subprocess.PIPE, text=True)
    os.close(writer)
    assert (done.returncode, done.stderr) == (1, "")


def test_only_the_first_process_speaks(monkeypatch, capsys):
    """As Lightning says, or its launcher until it is imported."""
    for known, variables, first in (
        (None, {}, True),
        (None, {"RANK": "1"}, False),
        (None, {"LOCAL_RANK": "1", "SLURM_PROCID": "0"}, False),
        (None, {"SLURM_PROCID": "3"}, False),
        (0, {"RANK": "1"}, True),
        (1, {}, False),
    ):
        for name in processes.RANK_VARIABLES:
            monkeypatch.delenv(name, raising=False)
        for name, value in variables.items():
            monkeypatch.setenv(name, value)
        monkeypatch.setattr(processes.rank_zero_only, "rank", known)
        processes.print_once("here")
        assert processes.is_first() is first, (known, variables)
        assert capsys.readouterr().out == ("here\n" if first else "")


def run_fit(argv):
    sys.argv = ["fit.py", *argv]
    hydra_commands.run(fit.main, Config)


MAINS = {
    "fit": run_fit,
    "frontier": frontier.main,
    "calibrate": calibrate.main,
    "synthesise": synthesise.main,
    "demoire": demoire.main,
}


@pytest.mark.parametrize("name", MAINS)
def test_every_command_prints_what_its_output_can_show(name, monkeypatch):
    errors = "surrogateescape" if name == "demoire" else "strict"
    GlobalHydra.instance().clear()
    monkeypatch.setattr(sys, "argv", [])
    monkeypatch.setattr(sys, "stderr", sys.stderr)
    monkeypatch.setattr(sys, "stdout", output := io.TextIOWrapper(io.BytesIO(), "ascii", errors))
    with contextlib.suppress(SystemExit):
        MAINS[name](["--help"])
    print("Moiré: −1 × 2", flush=True)
    assert output.buffer.getvalue().endswith(b"Moire: -1 x 2\n")


def test_a_gpu_that_is_left_alone_is_not_on_record(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda: "H100")
    devices = [machine.environment(accelerator)["device"] for accelerator in ("auto", "cpu")]
    assert devices == ["H100", "cpu"]


def odd(cfg):
    """A job of a sweep, which fails with some seeds."""
    if cfg.seed == 1:
        raise ValueError("seed 1 is odd.")
    if cfg.seed == 2:
        raise ZeroDivisionError("nobody expects it")
    print("done", cfg.recipe, cfg.seed)


def test_the_flag_of_a_sweep_may_come_last(tmp_path, monkeypatch):
    """Lightning appends settings to the command line of further processes."""
    seen = []
    monkeypatch.setattr(fit, "fit", lambda cfg: seen.append((cfg.runs, sys.argv[1])))
    assert inside("fit.py", "recipe=clean", "runs=a,b", "-m", cwd=tmp_path).returncode == 0
    assert seen == [("a", "-m"), ("b", "-m")]
    assert not (tmp_path / "a,b").exists(), "a folder of several folders' names"


def test_a_sweep_outlives_failed_jobs_and_lists_them(tmp_path, monkeypatch):
    monkeypatch.setattr(fit, "fit", odd)
    done = inside("fit.py", "-m", "recipe=clean", "seed=0,1,2,3", cwd=tmp_path)
    said = [line for line in done.stdout.splitlines() if line.startswith("done")]
    assert said == ["done clean 0", "done clean 3"] and done.returncode == 1
    *_, tail = done.stderr.rpartition("error: 2 of the sweep's jobs failed:\n")
    failed = "  recipe=clean seed=1: seed 1 is odd.\n  recipe=clean seed=2: nobody expects it\n"
    assert tail == failed
    assert "ZeroDivisionError" in done.stderr, "what nobody expected keeps its traceback"


@pytest.mark.parametrize("command", ["fit", "calibrate"])
def test_a_command_without_a_terminal_works(command, monkeypatch):
    """As in daemons, and in programs without a console."""
    for stream in ("stdout", "stderr"):
        monkeypatch.setattr(sys, stream, None)
    monkeypatch.setattr(sys, "argv", ["fit.py", "recipe=clean"])
    worked = []

    def work():
        for stream in (sys.stdout, sys.stderr):
            print("a line", file=stream, flush=True)
            with tqdm(total=1, file=stream, disable=None) as bar:
                bar.write("a line", file=stream)
        worked.append(sys.stdout.isatty())

    if command == "fit":
        hydra_commands.run(work, Config)
    else:
        plain_commands.parse(["photos=p"], calibrate.Config, calibrate.EXAMPLE, None)
        work()
    messages.print_error("error: of nobody's")
    assert worked == [False]


def test_a_command_leaves_the_logger_of_compilation(tmp_path, monkeypatch):
    monkeypatch.setattr(fit, "fit", odd)
    logger = logging.getLogger("moireaug")
    assert inside("fit.py", "recipe=clean", "seed=0", cwd=tmp_path).returncode == 0
    assert not logger.disabled and logger.isEnabledFor(logging.WARNING)


def test_a_finished_run_is_only_read(tmp_path, monkeypatch):
    """From media that cannot be written, too: neither locked nor made ready."""
    monkeypatch.setattr(Run, "locked", lambda run: pytest.fail("it was locked"))
    for task in (ClassificationTask, DemoireingTask):
        monkeypatch.setattr(task, "finished", lambda task, run: ({"found": run.config.seed}, []))
    cfg = configured("recipe=clean", *TINY, f"runs={tmp_path / 'gone'}")
    assert fit.fit(cfg) == {"found": 0}
    assert demoireing.fit(configured(f"runs={tmp_path / 'gone'}", name="demoire")) == {"found": 0}
    assert not (tmp_path / "gone").exists()
