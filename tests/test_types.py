"""What a type checker says of a user's script: nothing of one that is right, and each mistake of
one that is not."""

import re
from pathlib import Path
from typing import get_args

import mypy.api
import pytest

from moireaug import Scene
from moireaug.scene.by_name import values_of
from moireaug.scene.drawn_parts import __file__ as DRAWN_PARTS
from moireaug.scene.preset_names import MixtureName, PresetName
from moireaug.scene.presets import MIXTURES, PRESETS

ROOT = Path(__file__).parents[1]

RIGHT = """
import dataclasses

import torch
from typing_extensions import assert_type

import moireaug
from moireaug import Plan, Scene, Shot, View, attacks, capture, nn, transforms
from moireaug.transforms import AdversarialMoire, RandomMoire

scene = Scene.preset("screen_photo").with_shrink((1, 3))
assert_type(scene, Scene)
assert_type(scene.plan((32, 32)), Plan)
for name in Scene.presets():
    print(Scene.preset(name))
own = Scene(view=View(yaw=(-20, 20), fit=False), tolerance=0.01)

shot = scene.sample(2, (32, 32))
assert_type(shot, Shot)
assert_type(shot[:1].to("cpu"), Shot)
assert_type(shot.view.yaw, torch.Tensor)
assert_type(shot.panel.layout, str | moireaug.Layout)
assert_type(shot.scene.view.fit, bool)
frontal = dataclasses.replace(shot.view, yaw=torch.zeros(2))
photos = capture(torch.rand(2, 3, 32, 32), dataclasses.replace(shot, view=frontal))

model = torch.nn.Identity()
random = RandomMoire("anywhere", p=0.5, shrink=(1, 3))
mixed = transforms.RandomMoire([own, "paper", {"preset": "screen_photo"}])
transforms.kornia.RandomMoire("phone_at_laptop", same_on_batch=True)
transforms.albumentations.RandomMoire(own, p=1.0)
AdversarialMoire(model, scene="screen_photo", eps=8 / 255)
attacks.MoireAttack(model, scene=own, steps=5)
nn.ScreenCamera("screen_photo", jitter=1.0)
"""

# each line with the code of its error, if it has one
WRONG = """
import torch

from moireaug import Scene, View, capture, transforms
from moireaug.transforms import RandomMoire

RandomMoire(foo=3)  # call-arg
RandomMoire("screen_foto")  # arg-type
RandomMoire(["screen_photo", "screen_foto"])  # list-item
transforms.RandomMoire(p="often")  # arg-type
transforms.kornia.RandomMoire(foo=3)  # call-arg
transforms.albumentations.RandomMoire("screen_foto")  # arg-type
transforms.RandomMoir  # attr-defined
Scene.preset("screen_foto")  # arg-type
Scene.preset("anywhere")  # arg-type
Scene(view=View(yaw="left"))  # arg-type
shot = Scene().sample(2, (8, 8))
shot.view.yow  # attr-defined
shot.view.yaw + "left"  # operator
capture(torch.rand(2, 3, 8, 8), Scene())  # arg-type
"""


def errors(script, folder):
    """The code of the error of each line of a script that has one."""
    file = folder / "script.py"
    file.write_text(script)
    # the project's settings and cache: to read PyTorch anew takes mypy a minute
    options = [f"--config-file={ROOT / 'pyproject.toml'}", f"--cache-dir={ROOT / '.mypy_cache'}"]
    told, trouble, _ = mypy.api.run([*options, str(file)])
    assert not trouble
    return {int(line): code for line, code in re.findall(r":(\d+): error: .*\[(.+)\]", told)}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("MYPYPATH", str(ROOT))
    return tmp_path


def test_a_script_that_is_right_has_no_error(folder):
    assert errors(RIGHT, folder) == {}


def test_each_mistake_of_a_script_is_found(folder):
    expected = {}
    for number, line in enumerate(WRONG.splitlines(), 1):
        if "  # " in line:
            expected[number] = line.split("  # ")[1]
    assert errors(WRONG, folder) == expected


def test_names_that_type_checkers_know_are_those_of_the_presets():
    assert set(get_args(PresetName)) == set(PRESETS) == set(Scene.presets())
    assert get_args(MixtureName) == tuple(MIXTURES)


def test_numbers_of_a_shot_are_those_that_type_checkers_know():
    with open(DRAWN_PARTS, encoding="utf-8") as file:
        named = re.findall(r"class Drawn(\w+)|^ {8}(\w+): Tensor", file.read(), re.MULTILINE)
    part, known = "", []
    for begun, field in named:
        part = begun.lower() or part
        known += [f"{part}.{field}"] if field else []
    assert known == list(values_of(Scene()))
