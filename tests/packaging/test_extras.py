"""Optional dependencies: the core imports without them, and what needs one says how to install
it."""

import importlib.util
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import moireaug
from moireaug import extras

ROOT = Path(__file__).resolve().parents[2]
DISTRIBUTIONS = {
    "skimage": "scikit-image",
    "pywt": "PyWavelets",
    "hydra": "hydra-core",
    "yaml": "pyyaml",
    "omegaconf": "hydra-core",
}

WITHOUT = """
import importlib, sys
packages = dict(argument.split("=") for argument in sys.argv[1:])
hidden = set(",".join(packages.values()).split(","))
class Hidden:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in hidden:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
import importlib.util
found = importlib.util.find_spec
importlib.util.find_spec = lambda name, *rest: None if name in hidden else found(name, *rest)
sys.meta_path.insert(0, Hidden())
import moireaug, moireaug.attacks, moireaug.transforms, moireaug.synthesis.pairs
for package, names in packages.items():
    hidden = set(names.split(","))
    try:
        importlib.import_module(package)
    except ModuleNotFoundError as error:
        print(error)
"""


def test_the_core_works_without_an_extra_and_names_it():
    cases = [
        ("moireaug.defenses", "pandas,skimage,tqdm", "eval"),
        ("training", "hydra,matplotlib,omegaconf", "train"),
    ]
    given = [f"{package}={hidden}" for package, hidden, _ in cases]
    program = [sys.executable, "-c", WITHOUT, *given]
    done = subprocess.run(program, cwd=ROOT, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    for (package, hidden, extra), said in zip(cases, done.stdout.splitlines(), strict=True):
        names = hidden.replace(",", ", ")
        assert said.startswith(f"{package} needs {names}, not installed here.")
        assert said.endswith(f"Install with: pip install 'moireaug[{extra}]'")


def test_nothing_is_asked_for_where_everything_is_installed(monkeypatch):
    asked = []
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: asked.append(name) or object())
    assert extras.require("train", "training") is None
    assert set(asked) == {*extras.MODULES["train"], *extras.MODULES["eval"]}


def test_every_module_asked_for_is_in_its_extra():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    for extra, modules in extras.MODULES.items():
        wanted = project["optional-dependencies"][extra]
        names = {requirement.split(">=")[0] for requirement in wanted}
        for module in modules:
            assert DISTRIBUTIONS.get(module, module) in names, f"{module} is not in [{extra}]"


def test_the_package_names_what_it_has():
    assert {"Scene", "capture", *moireaug.LAZY} <= set(dir(moireaug))
    with pytest.raises(AttributeError, match=r"'atacks'; it has Develop, .*capture.*attacks"):
        _ = moireaug.atacks
