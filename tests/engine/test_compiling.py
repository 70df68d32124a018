"""Kernels are kept in a folder that is named by all they are compiled from."""

import ast
import os
import threading
import time
from pathlib import Path

import numba
import numpy as np
import pytest

import moireaug
from moireaug import Panel, Scene, Sensor, View
from moireaug.engine.cpu import compiling
from moireaug.engine.lower.exposure import lower_exposure

PACKAGE = Path(moireaug.__file__).parent
KERNELS = PACKAGE / "engine" / "cpu"


def imported(source):
    """The files of moireaug that a file imports from."""
    found = set()
    for node in ast.walk(ast.parse(source.read_text())):
        if not isinstance(node, ast.ImportFrom) or not node.module.startswith("moireaug"):
            continue
        place = PACKAGE.parent / node.module.replace(".", "/")
        if place.is_dir():  # a package, whose modules are named
            found.update(place / f"{alias.name}.py" for alias in node.names)
        else:
            found.add(place.with_suffix(".py"))
    return found


def compiled():
    """The files that kernels are compiled from: those that Python calls, those that they import,
    and so on within the engine."""
    records = PACKAGE / "engine" / "lower"
    found, ahead = set(), [*KERNELS.glob("*_kernels.py"), *records.glob("*_records.py")]
    while ahead:
        source = ahead.pop()
        found.add(source)
        if source.parent in (KERNELS, KERNELS.parent, records):
            ahead.extend(imported(source) - found)
    return found


def test_kernels_are_found():
    names = {source.stem for source in compiled()}
    assert {"expose_kernels", "footprint", "view", "random_numbers", "compiling"} <= names


def test_all_sources_outside_the_kernels_folders_are_named():
    folders = KERNELS, compiling.FORMULAS
    outside = [source for source in compiled() if source.parent not in folders]
    assert sorted(str(s.relative_to(PACKAGE)) for s in outside) == sorted(
        compiling.CONSTANT_SOURCES
    )


def test_a_change_of_a_constant_makes_another_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    folders, read = {compiling.folder.__wrapped__()}, Path.read_bytes
    for name in compiling.CONSTANT_SOURCES:

        def changed(source, name=name):
            return read(source) + (b"# changed" if source == PACKAGE / name else b"")

        monkeypatch.setattr(Path, "read_bytes", changed)
        folders.add(compiling.folder.__wrapped__())
    assert len(folders) == 1 + len(compiling.CONSTANT_SOURCES)


def test_a_compilation_runs_aside_and_its_error_reaches_the_caller(tmp_path, monkeypatch):
    monkeypatch.setattr(compiling, "folder", lambda: str(tmp_path))
    assert compiling._in_own_thread(threading.current_thread) is not threading.current_thread()

    def double(x):
        return 2 * x

    def misspelt(x):
        return x.relly

    assert compiling.kernel(double)(4) == 8
    with pytest.raises(numba.TypingError, match="relly"):
        compiling.kernel(misspelt)(4)


@pytest.mark.parametrize("glare", [0.0, 0.1])
def test_arrays_have_the_layout_that_kernels_are_compiled_for(glare):
    """For another one, numba compiles them again."""
    scene = Scene(panel=Panel(glare=glare), view=View(roll=(-5, 5)))
    assert ("glare" in scene.plan()) == (glare > 0)
    exposure, view = lower_exposure(scene.sample(4, (8, 8))[::2], decoded=False)
    arrays = [values for values in (*exposure, *view) if isinstance(values, np.ndarray)]
    assert len(arrays) == 11 and all(values.flags.c_contiguous for values in arrays)


def test_kernels_are_compiled_for_one_type_of_shot():
    presets = "screen_photo", "phone_at_led_wall", "phone_at_phone"
    sensors = Sensor(), Sensor(scale=2.0), Sensor(crosstalk=0.1)
    scenes = [*map(Scene.preset, presets), *(Scene(sensor=sensor) for sensor in sensors)]
    shots = [scene.sample(n, (8, 8)) for scene in scenes for n in (1, 2)]
    lowered = [lower_exposure(shot, decoded=False)[0] for shot in shots]
    assert len({numba.typeof(exposure) for exposure in lowered}) == 1


def test_kernels_that_nobody_uses_are_removed_with_the_next(tmp_path, monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    unused, used = (tmp_path / f"moireaug-{digit * 16}" for digit in "1f")
    other = tmp_path / "moireaug-results"  # a user's own
    for path, days in ((unused, 31), (used, 29), (other, 31)):
        (path / "cpu").mkdir(parents=True)
        os.utime(path, (0, time.time() - days * 24 * 3600))
    folder = Path(compiling.folder.__wrapped__())
    assert set(tmp_path.iterdir()) == {used, other, folder}


def test_without_a_home_kernels_are_kept_beside_the_sources(tmp_path, monkeypatch):
    for name in ("HOME", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)  # no entry of this user
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    compiling.folder.cache_clear()
    try:
        assert compiling.folder().startswith(str(tmp_path))
    finally:
        compiling.folder.cache_clear()
