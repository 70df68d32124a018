"""Every example runs, at a tiny size, and prints and writes what its docstring says."""

import contextlib
import json
import re
import runpy
import signal
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from tests.training.small import inside

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES, TUTORIALS = ROOT / "examples", ROOT / "docs" / "tutorials"

# script: its arguments, what it prints, the files that it writes
RUNS = {
    "photograph_a_picture": (
        ["--side=48", "--scene=anywhere", "--out=new/here.png"],
        r"\d\d effects are computed.* yaw -?\d.*The moiré is \d+\.\d of 255 codes RMS",
        ["new/here.png"],
    ),
    "torchvision_training": (
        ["--images=32", "--epochs=1"],
        r"RandomMoire\(p=0\.0\): \d+% clean, .*RandomMoire\(p=0\.5\): \d+% clean, \d+% photo",
        [],
    ),
    "kornia_on_the_gpu": (
        ["--batch=4", "--size=32", "--batches=1"],
        r"RandomMoire_1.* images of 32 px per second.*same pixels: True.*only 0 and 1: True",
        [],
    ),
    "albumentations_dataloader": (
        ["--images=32", "--size=24", "--workers=1"],
        r"epoch 0: \d\d% photographed, their screens (\d+)\.\d\d px wide.*epoch 1: ",
        [],
    ),
    "attack_your_classifier": (
        ["--images=32", "--epochs=1", "--attacked=4", "--steps=1", "--out=new/here.png"],
        r"clean images +\d+%\nphotos, no noise +\d+%\nMoiré Attack 2/255 .*Attack 8/255 +\d+%",
        ["new/here.png"],
    ),
    "evaluate_your_defence": (
        ["--images=32", "--epochs=1", "--attacked=4", "--steps=1"],
        r" bare defended\n.*clean +\d+% +\d+%\n.*worst_4 .*not know of the defence: \d+%",
        [],
    ),
    "calibrate_to_your_camera": (
        ["--size=32", "--evaluations=1"],
        r"distance 0\.\d+ at the start.*lens\.blur: \(0\.4, 0\.6\) before, .*RandomMoire\(",
        ["calibrated/scene.yaml", "calibrated/report.html"],
    ),
    "train_a_demoireing_network": (
        ["--crop=32", "--steps=1", "--width=0.1", "--out=new/there"],
        r"without moiré: \d\d\.\d\d dB as taken\n +-?\d+\.\d\d dB cleaned",
        ["new/there/demoire.pt", "new/there/demoired.png"],
    ),
    "detect_screen_photos": (
        ["--crops=2"],
        r"simulated: 1 of 3 screens, AUC [01]\.\d{3}\n",
        ["roc.png"],
    ),
    "watermark_through_the_camera": (
        ["--steps=1"],
        r"no camera: \d+% read in images, .*the camera: \d+% .*, \d+% in photos",
        [],
    ),
}


@pytest.mark.parametrize("name", RUNS)
def test_examples_print_and_write_what_they_say(name, tmp_path, monkeypatch, capsys):
    arguments, printed, written = RUNS[name]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr(sys, "argv", [name, *arguments])
    runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    said = capsys.readouterr().out
    assert re.search(printed, said, re.DOTALL), said
    found = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert {str(path.relative_to(tmp_path)) for path in found} >= set(written)


def test_help_says_what_a_script_does(monkeypatch, capsys):
    commands = ("calibrate", "demoire", "frontier", "synthesise")
    for file in (*EXAMPLES.glob("*.py"), *(ROOT / f"training/{name}.py" for name in commands)):
        monkeypatch.setattr(sys, "path", list(sys.path))
        monkeypatch.setattr(sys, "argv", [str(file), "--help"])
        with contextlib.suppress(SystemExit):
            runpy.run_path(str(file), run_name="__main__")
        does = file.read_text("utf-8").partition("\n")[0].strip('r"')
        assert does in " ".join(capsys.readouterr().out.split()), file.name


def test_every_example_is_run_and_short_enough_to_read():
    scripts = {path.stem: path.read_text(encoding="utf-8") for path in EXAMPLES.glob("*.py")}
    assert scripts.keys() == RUNS.keys()
    assert {path.stem for path in TUTORIALS.glob("*.ipynb")} == NOTEBOOKS.keys()
    for name, text in scripts.items():
        assert 30 <= text.count("\n") <= 85, name
        assert f"    python examples/{name}.py" in text, f"{name} does not say how it is run"


def test_an_example_finds_the_training_code_without_its_installation():
    for file in (*EXAMPLES.glob("*.py"), *TUTORIALS.glob("*")):
        before, used, _ = file.read_text("utf-8").partition("from training")
        assert not used or "sys.path.insert(0, " in before, file.name


# notebook: what its first cell, which holds the settings, is replaced with; what it prints
NOTEBOOKS = {
    "augment": (
        'SIDE, SCENE, SEED = 48, "screen_photo", 0',
        r"\d\d effects are computed.* of 255 codes RMS",
    ),
    "attack": (
        "IMAGES, EPOCHS, ATTACKED, STEPS, SIDE = 32, 1, 4, 1, 32",
        r"clean images +\d+%.*Moiré Attack 8/255 +\d+%",
    ),
    "train": (
        "IMAGES, EPOCHS, SIZE, ATTACKED, STEPS = 80, 1, 24, 16, 1",
        r"clean image .*training: .*\['",
    ),
    "pairs": ('SIDE, PAIRS, SCENE = 48, 2, ["phone_at_monitor"]', r"moiré, codes RMS: \d.*True"),
    "calibrate": ("SIZE, EVALUATIONS = 32, 1", r"lens\.blur: .* before, .* fitted, .* true"),
    "layer": ("SIDE, STEPS, SEED = 32, 2, 1", r"error of the photo: \d.* codes RMS, then \d"),
}


def run_inside(command, **_):
    """Run a command of the training code in this process, which need not import for seconds."""
    script, *given = command[1:]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        done = inside(Path(script).name, *given, cwd=Path.cwd())
    signal.signal(signal.SIGINT, signal.default_int_handler)  # which Lightning replaces
    assert done.returncode == 0, done.stderr
    return done


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_notebooks_run_and_hold_their_output(name, monkeypatch, capsys):
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr(subprocess, "run", run_inside)
    settings, printed = NOTEBOOKS[name]
    file = TUTORIALS / f"{name}.ipynb"
    assert file.stat().st_size < 300_000
    cells = [c for c in json.loads(file.read_text("utf-8"))["cells"] if c["cell_type"] == "code"]
    first, *others = ("".join(cell["source"]) for cell in cells)
    assert first.partition(" = ")[0] == settings.partition(" = ")[0]
    names = {}
    for code in (settings, *others):
        exec(compile(code, file.name, "exec"), names)
    assert re.search(printed, capsys.readouterr().out, re.DOTALL)
    kept = json.dumps([cell["outputs"] for cell in cells], ensure_ascii=False)
    assert re.search(printed, kept, re.DOTALL) and "image/jpeg" in kept
    assert '"output_type": "error"' not in kept
