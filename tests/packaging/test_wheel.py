"""The wheel, the source distribution, the core alone, and optional dependencies."""

import ast
import importlib.util
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
from moireaug.common import extras

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
SOURCES = ("pyproject.toml", "README.md", "LICENSE", "NOTICE.md", "MANIFEST.in")
FOLDERS = ("moireaug", "training", "recipes")
BUILD = """
from setuptools import build_meta
build_meta.build_wheel("dist")
build_meta.build_sdist("dist")
"""
# distribution to the module that it installs, where the two differ, and the other way round
MODULES = {"pillow": "PIL"}
DISTRIBUTIONS = {"skimage": "scikit-image", "pywt": "PyWavelets", "yaml": "pyyaml"}
DISTRIBUTIONS |= {"cv2": "opencv-python-headless", "hydra": "hydra-core", "omegaconf": "hydra-core"}
COMPILER = "llvmlite"  # numba's
ASKS = re.compile(r"\brequire\(\s*\"\w+\"")  # for an extra, before anything of it is imported
# which transforms/albumentations.py alone imports, once it has asked
BEHIND = ("_albumentations_base.py", "_workers.py")

# what is printed by each: the version, the photo and where it was found; and a missing extra
CORE = """
import sys, torch, moireaug, moireaug.attacks, moireaug.transforms, moireaug.synthesis.pairs
photo = moireaug.transforms.RandomMoire("screen_photo", p=1)(torch.rand(1, 3, 16, 16))
print(moireaug.__version__, tuple(photo.shape), moireaug.__file__)
sys.path.append(sys.argv[3])
for name in sys.argv[4].split(","):
    try:
        __import__(name)
    except ModuleNotFoundError as error:
        print(error)
try:
    moireaug.Scene(develop=moireaug.Develop(denoise="nlm")).capture(torch.rand(1, 3, 16, 16))
except ModuleNotFoundError as error:
    print(error)
"""


def names(requirements):
    return {re.match(r"[\w.-]+", requirement).group() for requirement in requirements}


def files_of(folder):
    """Return the files of a folder, relative to the repository."""
    files = (path for path in (ROOT / folder).rglob("*") if path.is_file())
    return {p.relative_to(ROOT).as_posix() for p in files if "__pycache__" not in p.parts}


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
    needed = {"moireaug.evaluation": "eval", "moireaug.defenses": "eval", "training": "train"}
    needed["moireaug.transforms.albumentations"] = "albumentations"
    script = Path(__file__).with_name("core_alone.py")
    done = subprocess.run(
        [sys.executable, str(script), core, CORE, str(ROOT), ",".join(needed)],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(tmp_path), "MOIREAUG_ENGINE": "off"},
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert done.returncode == 0, done.stderr
    photo, *missing = done.stdout.splitlines()
    assert photo == f"{moireaug.__version__} (1, 3, 16, 16) {tmp_path / 'moireaug/__init__.py'}"
    needed["the denoiser 'nlm'"] = "opencv"
    for said, (package, extra) in zip(missing, needed.items(), strict=True):
        assert said.startswith(f"{package} needs "), said
        assert said.endswith(f"in a clone of the repository: pip install '.[{extra}]'")


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
    for path in sorted((ROOT / "moireaug").rglob("*.py")):
        room = path.relative_to(ROOT / "moireaug").parts[0]
        asked = [path, ROOT / "moireaug" / room / "__init__.py"]
        if any(one.is_file() and ASKS.search(one.read_text("utf-8")) for one in asked):
            asking.append(room)
        elif path.name not in BEHIND:
            # PyTorch brings Triton where there may be a GPU; nothing else imports those files
            ours = {"triton"} if path.parent == ROOT / "moireaug" / "engine" / "gpu" else set()
            assert not imported(path) - allowed - ours, path
    assert {"evaluation", "defenses", "transforms", "camera"} <= set(asking)


def test_what_is_missing_is_named_with_its_extra(monkeypatch):
    hidden = ["hydra", "matplotlib", "skimage"]
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name in hidden else name)
    said = r"^a file needs hydra, matplotlib, skimage, not .* pip install '\.\[train\]'$"
    with pytest.raises(ModuleNotFoundError, match=said):
        extras.require("train", "a file")


def test_nothing_is_asked_for_where_everything_is_installed(monkeypatch):
    asked = []
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: asked.append(name) or object())
    assert extras.require("train", "training") is None
    needed = ("train", "eval", "opencv")
    assert set(asked) == {module for extra in needed for module in extras.MODULES[extra]}


def test_every_module_asked_for_is_in_its_extra():
    for extra, modules in extras.MODULES.items():
        wanted = names(PROJECT["optional-dependencies"][extra])
        for module in modules:
            assert DISTRIBUTIONS.get(module, module) in wanted, f"{module} is not in [{extra}]"


def test_the_package_names_what_it_has():
    assert {"Scene", "capture", *moireaug.LAZY} <= set(dir(moireaug))
    with pytest.raises(AttributeError, match=r"'atacks'; it has Develop, .*capture.*attacks"):
        _ = moireaug.atacks
