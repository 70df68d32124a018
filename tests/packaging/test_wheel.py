"""The wheel: its metadata, its files, and its core where nothing but the core's dependencies is
installed; and the source distribution, which has the commands too."""

import ast
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from email.parser import Parser
from pathlib import Path

import pytest

import moireaug

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
SOURCES = ("pyproject.toml", "README.md", "LICENSE", "NOTICE.md", "MANIFEST.in")
FOLDERS = ("moireaug", "training", "recipes")
BUILD = """
from setuptools import build_meta
build_meta.build_wheel("dist")
build_meta.build_sdist("dist")
"""
# distribution to the module that it installs, where the two differ
MODULES = {"opencv-python-headless": "cv2", "pillow": "PIL"}
COMPILER = "llvmlite"  # numba's
ASKS = re.compile(r"\brequire\(\s*\"\w+\"")  # for an extra, before anything of it is imported

CAPTURE = """
import torch, moireaug
scene = moireaug.Scene.preset("screen_photo")
shot = scene.sample(1, (16, 16))
photo = moireaug.capture(torch.rand(1, 3, 16, 16), shot)
print(moireaug.__version__, tuple(photo.shape), moireaug.__file__)
try:
    moireaug.evaluation
except ModuleNotFoundError as error:
    print(error)
"""


def names(requirements):
    return {re.match(r"[\w.-]+", requirement).group() for requirement in requirements}


def files_of(folder):
    """Return the files of a folder, relative to the repository."""
    paths = set()
    for path in (ROOT / folder).rglob("*"):
        if path.is_file() and "__pycache__" not in path.parts:
            paths.add(path.relative_to(ROOT).as_posix())
    return paths


@pytest.fixture(scope="module")
def distributions(tmp_path_factory):
    """The folder of the distributions, built from a copy of the sources, so that nothing is left in
    them."""
    copy = tmp_path_factory.mktemp("sources")
    for name in SOURCES:
        shutil.copy(ROOT / name, copy)
    for name in FOLDERS:
        unwanted = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / name, copy / name, ignore=unwanted)
    program = [sys.executable, "-c", BUILD]
    done = subprocess.run(program, cwd=copy, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    return copy / "dist"


@pytest.fixture(scope="module")
def wheel(distributions):
    (path,) = distributions.glob("*.whl")
    return zipfile.ZipFile(path)


def test_metadata_repeats_the_project(wheel):
    (path,) = (name for name in wheel.namelist() if name.endswith(".dist-info/METADATA"))
    metadata = Parser().parsestr(wheel.read(path).decode())
    assert metadata["Version"] == moireaug.__version__
    assert metadata["License-Expression"] == PROJECT["license"]
    assert metadata.get_all("License-File") == PROJECT["license-files"]
    core = [line for line in metadata.get_all("Requires-Dist") if "extra ==" not in line]
    assert names(core) == names(PROJECT["dependencies"])
    assert set(metadata.get_all("Provides-Extra")) == set(PROJECT["optional-dependencies"])


def test_the_wheel_holds_the_library_alone(wheel):
    files = {name for name in wheel.namelist() if ".dist-info/" not in name}
    assert files == files_of("moireaug")


def test_the_source_distribution_holds_the_commands_and_their_recipes(distributions):
    (path,) = distributions.glob("*.tar.gz")
    with tarfile.open(path) as archive:
        files = {name.partition("/")[2] for name in archive.getnames()}
    for folder in FOLDERS:
        assert files_of(folder) <= files


def test_the_core_works_without_any_extra(wheel, tmp_path):
    wheel.extractall(tmp_path)
    core = ",".join(names(PROJECT["dependencies"]))
    script = Path(__file__).with_name("core_alone.py")
    done = subprocess.run(
        [sys.executable, str(script), core, CAPTURE],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(tmp_path), "MOIREAUG_ENGINE": "off"},
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert done.returncode == 0, done.stderr
    photo, missing = done.stdout.splitlines()
    assert photo == f"{moireaug.__version__} (1, 3, 16, 16) {tmp_path / 'moireaug/__init__.py'}"
    assert missing.startswith("moireaug.evaluation needs ")
    assert missing.endswith("Install with: pip install 'moireaug[eval]'")


def imported(path):
    """Return the top-level modules that a file imports, at any depth."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            found.add(node.module.split(".")[0])
    return found


def test_no_core_module_imports_an_extras_dependency():
    allowed = {"moireaug", COMPILER, *sys.stdlib_module_names}
    for name in names(PROJECT["dependencies"]):
        allowed.add(MODULES.get(name, name))
    asking = []
    for part in sorted((ROOT / "moireaug").iterdir()):
        modules = [part] if part.suffix == ".py" else list(part.rglob("*.py"))
        if any(ASKS.search(path.read_text("utf-8")) for path in modules):
            asking.append(part.name)
            continue
        for path in modules:
            # PyTorch brings Triton where there may be a GPU; nothing else imports those files
            ours = {"triton"} if path.parent == ROOT / "moireaug" / "engine" / "gpu" else set()
            assert not imported(path) - allowed - ours, path
    assert {"evaluation", "defenses"} <= set(asking)
