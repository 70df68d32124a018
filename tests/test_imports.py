"""The order of the house: no circle of files, and every import points down."""

import ast
import functools
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
# from the ground up: a file imports those of its own floor and of floors before it
LIBRARY = (
    ("common",),
    ("scene",),
    ("camera",),
    ("engine",),
    ("capture",),
    ("scenes",),
    ("mixtures", "warm_up"),
    ("synthesis",),
    ("attacks", "defenses"),
    ("transforms",),
    ("evaluation", "nn"),
)
APPLICATION = (
    ("system", "suites"),
    ("config",),
    ("data", "models", "photographs"),
    ("runs",),
    ("trainer", "report"),
    ("classifier",),
    ("attack",),
    ("calibration", "comparison", "pairs"),
    ("demoireing", "recipe"),
    ("detection",),
    ("fit", "reattack", "frontier", "synthesise", "calibrate", "demoire", "detect"),
)
FLOORS = {"moireaug": LIBRARY, "training": APPLICATION}
each_package = pytest.mark.parametrize("package", FLOORS)


def name_of(file, package):
    """Return a file's module, without the package's name: "" of the package itself."""
    parts = file.relative_to(ROOT / package).with_suffix("").parts
    return ".".join(part for part in parts if part != "__init__")


@functools.cache
def import_nodes(file):
    nodes = ast.walk(ast.parse(file.read_text(encoding="utf-8")))
    return [node for node in nodes if isinstance(node, (ast.Import, ast.ImportFrom))]


@functools.cache
def imports(package):
    """Return each module's imports of its package, anywhere in its file: {module: {module}}."""
    files = {name_of(file, package): file for file in (ROOT / package).rglob("*.py")}
    below = {}
    for name, file in files.items():
        below[name] = set()
        for node in import_nodes(file):
            if isinstance(node, ast.Import):
                named = [alias.name for alias in node.names]
            else:
                whole = [f"{node.module}.{alias.name}" for alias in node.names]
                known = [one for one in whole if one.removeprefix(f"{package}.") in files]
                parent = [node.module] if node.module != package else []
                named = [*known, *parent] if known else [node.module]
            for one in named:
                if one.split(".")[0] == package:
                    below[name].add(one.removeprefix(package).removeprefix("."))
        below[name].discard(name)  # a package that names its own files
    return below


def floor_of(module, package):
    """Return the floor whose longest name begins the module's."""
    matches = []
    for floor, names in enumerate(FLOORS[package]):
        for one in names:
            if module == one or module.startswith(f"{one}."):
                matches.append((len(one), floor))
    return max(matches)[1]


def circle(graph):
    """Return the modules of a circle of imports, or an empty list."""
    left = {module: set(below) for module, below in graph.items()}
    while True:
        free = [module for module, below in left.items() if not below & left.keys()]
        if not free:
            return sorted(left)
        for module in free:
            del left[module]


@each_package
def test_no_files_import_each_other_in_a_circle(package):
    assert circle(imports(package)) == []


def test_a_circle_of_imports_is_found():
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": set()}) == ["a", "b", "c"]


@each_package
def test_every_module_stands_on_a_floor_and_imports_point_down(package):
    above = []
    for module, below in imports(package).items():
        if not module:  # the package itself, which names what users import
            continue
        floor = floor_of(module, package)
        above += [(module, one) for one in below if one and floor_of(one, package) > floor]
    assert above == []


def test_no_command_imports_another():
    commands = APPLICATION[-1]
    for command in commands:
        assert imports("training")[command].isdisjoint(commands)


def test_the_library_never_imports_its_application():
    for file in (ROOT / "moireaug").rglob("*.py"):
        for node in import_nodes(file):
            modules = [getattr(node, "module", None) or "", *(alias.name for alias in node.names)]
            assert "training" not in {module.split(".")[0] for module in modules}, file


def names_in(file):
    """Return the names that a file defines or imports, wherever in it."""
    names = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
        elif isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            names.add(node.name)
        elif isinstance(node, ast.alias):
            names.add(node.asname or node.name)
    return names


@pytest.mark.parametrize("folder", ["docs", "benchmarks", "examples"])
def test_scripts_import_what_is_there(folder):
    """No type checker reads them, and few are run by tests."""
    missing = []
    for file in (ROOT / folder).glob("*.py"):
        for node in import_nodes(file):
            module = ROOT / (getattr(node, "module", None) or "").replace(".", "/")
            source = module / "__init__.py" if module.is_dir() else module.with_suffix(".py")
            if module == ROOT or not source.is_file():
                continue
            for alias in node.names:
                submodule = module / alias.name
                is_module = submodule.is_dir() or submodule.with_suffix(".py").is_file()
                if not is_module and alias.name not in names_in(source):
                    missing.append((file.name, node.module, alias.name))
    assert missing == []
