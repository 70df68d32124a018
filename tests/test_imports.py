"""The order of the house: no circle of files, and every import points down."""

import ast
import functools
from pathlib import Path

import moireaug

PACKAGE = Path(moireaug.__file__).parent
# from the ground up: a file imports those of its own floor and of floors before it
FLOORS = (
    ("numeric", "printing", "files", "extras", "object_graph", "networks", "weights"),
    ("scene",),
    ("panel", "geometry", "exposure.base"),
    ("plan",),
    ("shot", "mixed_shot", "draws"),
    ("image_checks", "shot_checks"),
    ("exposure",),
    ("effects",),
    ("pipeline",),
    ("engine",),
    ("capture",),
    ("scenes",),
    ("operators", "mixtures", "images"),
    ("synthesis",),
    ("attacks", "defenses"),
    ("transforms",),
    ("evaluation",),
)


def name_of(file):
    """Return a file's module, without the package's name: "" of the package itself."""
    parts = file.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(part for part in parts if part != "__init__")


@functools.cache
def imports():
    """Return each module's imports of the package, anywhere in its file: {module: {module}}."""
    files = {name_of(file): file for file in PACKAGE.rglob("*.py")}
    found = {}
    for name, file in files.items():
        found[name] = set()
        for node in ast.walk(ast.parse(file.read_text())):
            named = []
            if isinstance(node, ast.Import):
                named = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                whole = [f"{node.module}.{alias.name}" for alias in node.names]
                known = [one for one in whole if one.removeprefix("moireaug.") in files]
                package = [node.module] if node.module != "moireaug" else []
                named = [*known, *package] if known else [node.module]
            for one in named:
                if one.split(".")[0] == "moireaug":
                    found[name].add(one.removeprefix("moireaug").removeprefix("."))
        found[name].discard(name)  # a package that names its own files
    return found


def floor_of(module):
    """Return the floor whose longest name begins the module's."""
    matches = []
    for floor, names in enumerate(FLOORS):
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


def test_no_files_import_each_other_in_a_circle():
    assert circle(imports()) == []


def test_a_circle_of_imports_is_found():
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": set()}) == ["a", "b", "c"]


def test_every_module_stands_on_a_floor():
    for module in imports():
        assert not module or floor_of(module) >= 0


def test_imports_point_down():
    above = []
    for module, below in imports().items():
        if module:  # not the package itself, which names what users import
            above += [(module, one) for one in below if one and floor_of(one) > floor_of(module)]
    assert above == []


def test_the_library_never_imports_its_application():
    for file in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                assert "training" not in {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                assert (node.module or "").split(".")[0] != "training"
