"""Scene: ranges, validation, plain values; Shot: draws, replay, indexing."""

import copy
import json
import math
import pickle
import re
from collections import UserList
from fractions import Fraction
from types import MappingProxyType

import numpy as np
import pytest
import torch
import yaml

from moireaug import Develop, Layout, Lens, Panel, Scene, Sensor, Shot, View, capture
from moireaug.camera.scene_plans import CACHE_FIELDS
from moireaug.mixtures import as_scene
from moireaug.scene.by_name import values_of
from moireaug.scene.fields import bounds
from moireaug.scene.parts import PARTS
from moireaug.scene.presets import PRESETS

BAD = [
    (lambda: Panel(scale=(3, 1)), "low <= high"),
    (lambda: Panel(scale=(1, 2, 3)), "3 values"),
    (lambda: Panel(scale="big"), "must be a number"),
    (lambda: Panel(scale=True), "must be a number"),
    (lambda: Panel(scale=np.float64(-3)), "Panel.scale must lie in [0.0001, 100000]"),
    (lambda: Develop(registered="off"), "must be True or False"),
    (lambda: View(pose="pinhole"), "'camera', 'released'"),
    (lambda: Lens(k1=-0.5), "fold the photo"),
    (lambda: Lens(k1=(-0.1, 0.1), k2=(-0.4, 0.0)), "fold the photo"),
    (lambda: Sensor(scale=(1, 2)), "must be one number"),
    (lambda: Sensor(exposure="spectra"), "Did you mean 'spectral'?"),
    (lambda: Sensor(exposure="supersample:0"), "Sensor.exposure must be supersample:n"),
    (lambda: Scene(panel=View()), "Scene.panel must be a Panel"),
    (lambda: Scene.preset("phone_at_moniter"), "Did you mean 'phone_at_monitor'?"),
    (lambda: Scene.from_dict({"viev": {}}), "Did you mean 'view'?"),
    (lambda: Scene.from_dict({"view": {"role": 3}}), "Did you mean 'roll'?"),
    (lambda: as_scene(3), "a Scene, a preset's name or a dict; got int"),
    (lambda: Scene().sample(-1, (8, 8)), "n >= 0"),
    (lambda: Scene().sample(1, (8.9, 8)), "in whole numbers; got (8.9, 8)"),
    (lambda: Scene().sample(2.5, (8, 8)), "a whole number n >= 0 of images; got n = 2.5"),
]


@pytest.mark.parametrize(("make", "sentence"), BAD, ids=[b[1][:30] for b in BAD])
def test_wrong_values_get_a_sentence(make, sentence):
    with pytest.raises((ValueError, TypeError), match=re.escape(sentence)):
        make()


@pytest.mark.parametrize("cls", PARTS.values(), ids=PARTS)
def test_a_number_beyond_its_bounds_is_refused(cls):
    for field in cls.ranged:
        metadata = cls.__dataclass_fields__[field].metadata
        low, high = metadata["low"], metadata["high"]
        sentence = re.escape(f"{cls.__name__}.{field} must lie in [{low:g}, {high:g}]") + ".* got"
        for value in (low - 1, high + 1, (low, high + 1), math.nan, math.inf, 10**400):
            with pytest.raises(ValueError, match=sentence):
                cls(**{field: value})


OWN = Scene(panel=Panel(layout=Layout(((0, 0, 0, 0.5, 1), (1, 0.5, 0, 1, 1)))))


@pytest.mark.parametrize("scene", [*map(Scene.preset, PRESETS), OWN], ids=[*PRESETS, "own layout"])
def test_scenes_survive_json_yaml_and_pickle(scene):
    assert Scene.from_dict(json.loads(json.dumps(scene.to_dict()))) == scene
    assert Scene.from_dict(yaml.safe_load(yaml.dump(scene.to_dict()))) == scene
    assert pickle.loads(pickle.dumps(scene)) == scene
    assert hash(scene) == hash(Scene.from_dict(scene.to_dict()))


def test_a_dict_starts_from_a_preset():
    scene = Scene.from_dict({"preset": "screen_photo", "view": {"roll": [-3, 3]}})
    other = MappingProxyType({"preset": "screen_photo", "view": {"roll": UserList([-3, 3])}})
    assert Scene.from_dict(other) == as_scene(other) == scene  # as of OmegaConf's
    cell = {"subpixels": UserList([UserList([0, 0, 0, 1, 1])]), "period": UserList([1, 1])}
    panel = Scene.from_dict({"panel": {"layout": MappingProxyType(cell)}}).panel
    assert panel.layout == Layout(((0, 0, 0, 1, 1),))
    assert scene.view.roll == (-3.0, 3.0)
    assert scene.panel == Scene.preset("screen_photo").panel


@pytest.mark.parametrize("preset", PRESETS)
def test_draws_fill_their_ranges(preset):
    scene = Scene.preset(preset)
    shot, ranges = scene.sample(200, (8, 8), torch.Generator().manual_seed(0)), values_of(scene)
    for name, drawn in shot.numbers().items():
        low, high = bounds(ranges[name])
        assert drawn.shape == (200,) and drawn.dtype == torch.float64
        assert low <= drawn.min() and drawn.max() <= high, name
        if scene.is_drawn(name):
            assert drawn.max() - drawn.min() > 0.9 * (high - low), name
            assert drawn.unique().numel() > 30, name


def test_released_pose_turns_by_whole_degrees_and_keeps_what_else_is_drawn():
    """Its homography reads none of it."""
    shot = Scene.preset("paper_code").sample(200, (8, 8))
    for angle in (shot.view.yaw, shot.view.pitch, shot.view.roll):
        assert (angle == angle.round()).all()
        assert angle.min() >= -20 and angle.max() <= 19
    view = View(roll=(-20, 20), zoom=(0.5, 2), shift_x=(-0.3, 0.3), fov=(20, 50), pose="released")
    drawn = Scene(view=view).sample(200, (8, 8)).view
    for field in ("zoom", "shift_x", "fov"):
        low, high = bounds(getattr(view, field))
        values = getattr(drawn, field)
        assert (values >= low).all() and (values <= high).all() and (values != values.round()).any()


def test_same_seed_same_shot_and_prefix():
    scene = Scene.preset("screen_photo")
    draws = [(6, 5), (3, 5), (6, 6)]
    a, b, c = (scene.sample(n, (8, 8), torch.Generator().manual_seed(s)) for n, s in draws)
    assert torch.equal(a.view.roll[:3], b.view.roll) and torch.equal(a.seed[:3], b.seed)
    assert not torch.equal(a.view.roll, c.view.roll)


@pytest.mark.parametrize(
    "rows", [slice(1, 3), [1, 2], torch.tensor([1, 2]), torch.tensor([False, True, True, False])]
)
def test_rows_of_a_shot_are_rows_of_the_photo(rows, images):
    scene = Scene.preset("screen_photo")
    shot = scene.sample(4, (24, 32))
    assert torch.allclose(capture(images[rows], shot[rows]), capture(images, shot)[rows], atol=1e-6)
    assert len(shot[2]) == 1 and len(shot.repeat(3)) == 12


def test_a_damaged_shot_dict_is_refused():
    values = Scene().sample(2, (8, 8)).to_dict()
    with pytest.raises(ValueError, match="missing \\['seed'\\]"):
        Shot.from_dict({k: v for k, v in values.items() if k != "seed"})
    values["view"]["roll"] = [0.0]
    with pytest.raises(ValueError, match=r"view\.roll must hold 2 numbers"):
        Shot.from_dict(values)
    part = Scene.preset("screen_photo").sample(2, (8, 8)).crop(1, 2, 4, 4).to_dict()
    for whole in ({}, {"size": [8, 8], "corner": [1.5, 2]}, {"size": [8], "corner": [1, 2]}, 0):
        with pytest.raises(ValueError, match="a shot's part_of must hold the size"):
            Shot.from_dict({**part, "part_of": whole})


def test_a_pickled_shot_is_no_larger_than_its_numbers():
    few, many = (len(pickle.dumps(Scene().sample(n, (8, 8)))) for n in (1, 101))
    numbers = len(Scene().sample(1, (8, 8)).numbers()) + 1
    assert many - few < 1.2 * 100 * 8 * numbers


def test_numbers_of_any_kind_are_kept_as_plain_ones():
    stripe = Layout(((0, 0, 0, Fraction(1, 3), 1), (1, np.float32(0.5), 0, 1, 1)), (np.int64(1), 1))
    scene = Scene(panel=Panel(layout=stripe), sensor=Sensor(bits=np.int64(8)))
    assert Scene.from_dict(json.loads(json.dumps(scene.to_dict()))) == scene
    scene.capture(torch.rand(1, 3, 8, 8))


def test_a_copy_of_a_scene_makes_its_own_plan():
    scene = Scene.preset("screen_photo")
    scene.plan()
    for again in (pickle.loads(pickle.dumps(scene)), copy.deepcopy(scene)):
        assert again == scene and not set(CACHE_FIELDS) & vars(again).keys()
        assert str(again.plan()) == str(scene.plan())


def test_a_refused_size_leaves_nothing_behind():
    """8.0 is 8 to a cache."""
    values = Scene().sample(1, (8, 8)).to_dict()
    with pytest.raises(ValueError, match="whole numbers"):
        Shot.from_dict({**values, "size": [8.0, 8.0]})
    capture(torch.rand(1, 3, 8, 8), Shot.from_dict(values))


def test_photos_under_vmap_are_those_of_a_loop():
    scene, images = Scene.preset("screen_photo"), torch.rand(3, 3, 8, 8, dtype=torch.float64)
    shot = scene.sample(1, (8, 8))
    noise = 0.01 * torch.randn(3, *shot.raw_shape()[1:], dtype=torch.float64)
    together = torch.func.vmap(lambda x, n: capture(x[None], shot, n[None])[0])(images, noise)
    one_by_one = [capture(x[None], shot, n[None])[0] for x, n in zip(images, noise, strict=True)]
    assert torch.allclose(together, torch.stack(one_by_one), atol=1e-9)
