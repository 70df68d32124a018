"""Scenes and pictures that cannot be photographed: each gets a sentence with what is allowed."""

import dataclasses
import re

import numpy as np
import pytest
import torch

from moireaug import (
    Develop,
    Layout,
    Lens,
    Panel,
    Scene,
    Sensor,
    Shot,
    View,
    capture,
    develop,
    engine,
    expose,
)
from moireaug.mixtures import Mixture
from moireaug.scene.by_name import with_values
from moireaug.synthesis import without_moire
from moireaug.transforms import RandomMoire

X = torch.rand(1, 3, 4, 4)
SHOT, ONE = Scene().sample(1, (4, 4)), torch.ones(1, dtype=torch.float64)
RANGED = Scene(view=View(yaw=(0.0, 9.0), pitch=(0.0, 9.0), roll=(0.0, 9.0)))
PART = Scene(panel=Panel(width=90.0)).sample(1, (64, 64)).crop(4, 5, 8, 8)
MIXED = Mixture((Scene(), Scene())).sample(1, (4, 4))


def changed(**values):
    """The dict of a shot with other values, by key or by part_field."""
    found = SHOT.to_dict()
    for name, value in values.items():
        part, _, field = name.partition("_")
        if field:
            found[part] = {**found[part], field: value}
        else:
            found[name] = value
    return Shot.from_dict(found)


def having(**fields):
    """A shot with other values in its view or as its seed."""
    seed = fields.pop("seed", SHOT.seed)
    return dataclasses.replace(SHOT, view=SHOT.view.drawn(fields), seed=seed)


def with_float(part, **fields):
    """A shot of two with a plain number in a part, beside drawn ones."""
    shot = SHOT.repeat(2)
    return dataclasses.replace(shot, **{part: dataclasses.replace(getattr(shot, part), **fields)})


def unstated(name, part):
    """The photo of a shot with a 0 where its scene, of this part, states a number."""
    scene = Scene(**{type(part).__name__.lower(): part})
    return capture(X, with_values(scene.sample(1, (4, 4)), {name: ONE * 0}))


class OnGpu(torch.Generator):
    device = torch.device("cuda:0")


REFUSED = [
    (lambda: capture(X, having(yaw=10.0)), "here of shape (1,); got 10.0 as shot.view.yaw"),
    (lambda: capture(X, having(roll=np.zeros(1))), "got array([0.]) as shot.view.roll"),
    (lambda: develop(expose(X, SHOT), having(yaw=10.0)), "got 10.0 as shot.view.yaw"),
    (lambda: with_float("lens", k1=0.01), "here of shape (2,); got 0.01 as shot.lens.k1"),
    (lambda: capture(X, having(seed=[5])), "a shot's seed must be (B,) int64; got [5]"),
    (lambda: capture(X, with_values(SHOT, {"lens.k1": ONE * -0.5})), "fold the photo onto itself"),
    (lambda: capture(X, dataclasses.replace(SHOT, seed=SHOT.seed.float())), "(B,) int64; got (1,)"),
    (lambda: changed(size=[8.0, 8.0]), "in whole numbers; got [8.0, 8.0]"),
    (
        lambda: capture(X, SHOT, torch.full(SHOT.raw_shape(), 1e300, dtype=torch.float64)),
        "noise must be finite in float32",
    ),
    (lambda: changed(size=[8, 8, 8]), "in whole numbers; got [8, 8, 8]"),
    (lambda: changed(size=[0, -1]), "at least 1 x 1 pixels"),
    (
        lambda: dataclasses.replace(PART, size=(100, 100)),
        "a part must lie within the image of 64 x 64 pixels; got 100 x 100 from row 4 and column 5",
    ),
    (lambda: PART.crop(0, 0, 9, 8), "a part must lie within the image of 8 x 8 pixels; got 9 x 8"),
    (lambda: dataclasses.replace(PART, scene=Scene()), "a part needs a binned reading"),
    (lambda: dataclasses.replace(SHOT, size=(4, 4, 4)), "in whole numbers; got (4, 4, 4)"),
    (lambda: changed(seed=5), "seed must be a list of whole numbers; got 5"),
    (lambda: changed(seed=[1.5]), "seed must be a list of whole numbers; got [1.5]"),
    (lambda: changed(seed=[True]), "seed must be a list of whole numbers; got [True]"),
    (lambda: changed(seed=[2**63]), "seed must lie in [-2**63, 2**63)"),
    (lambda: changed(panel_scale=1.0), "panel.scale must hold 1 numbers"),
    (lambda: changed(panel_scale=[0.0]), "a shot's panel.scale must lie in [0.0001, 100000]"),
    (
        lambda: unstated("sensor.pitch", Sensor(pitch=(1.5, 2.0))),
        "shot.sensor.pitch lie in [0.001, 1000]; got [0.0]. Its scene states (1.5, 2.0): draw from",
    ),
    (lambda: unstated("panel.width", Panel(width=9.0)), "shot.panel.width lie in [1, 100000]; got"),
    (
        lambda: unstated("sensor.shrink", Sensor(pitch=2.0, shrink=2.0)),
        "shot.sensor.shrink lie in [0.1, 100]; got [0.0]. Its scene states 2.0: draw from it, or",
    ),
    (lambda: unstated("develop.jpeg", Develop(jpeg=9.0)), "shot.develop.jpeg lie in [1, 100]; got"),
    (
        lambda: Shot.from_dict({**SHOT.to_dict(), "scene": Scene(sensor=Sensor(pitch=2.0))}),
        "a shot's sensor.pitch must lie in [0.001, 1000] sensor pixels per panel pixel; got 0.0.",
    ),
    (lambda: changed(view_yaw=[float("nan")]), "a shot's view.yaw must lie in [-89, 89]"),
    (lambda: View(roll=2.7, pose="released"), "got 2.7. Round it, or use pose = 'camera'"),
    (lambda: Panel(layout={}), "Panel.layout must name its subpixels"),
    (lambda: Sensor(exposure="supersample:257"), "supersample:n with n from 1 to 256 where"),
    (lambda: Sensor(exposure="supersample:99", scale=3), "to 85 where Sensor.scale is 3, to read"),
    (lambda: changed(panel_scael=[1.0]), "Did you mean 'scale'?"),
    (lambda: changed(pannel={}), "Did you mean 'panel'?"),
    (lambda: Develop(jpeg=(0, 90)), "Develop.jpeg must be at least 1, or 0 alone for no JPEG; got"),
    (lambda: Develop(jpeg=0.5), "Develop.jpeg must be at least 1"),
    (lambda: Panel(pwm=(0, 200)), "Panel.pwm must be above 0, or 0 alone for steady light; got"),
    (
        lambda: Sensor(shutter=(0, 0.01)),
        "Sensor.shutter must be above 0, or 0 alone for no flicker",
    ),
    (lambda: Sensor(bits=0), "Sensor.bits must be a whole number in [1, 16]"),
    (lambda: RandomMoire("scene.yaml"), "Pass what it holds, yaml.safe_load(open('scene.yaml'))"),
    (lambda: Scene().sample(1, (0, 8)), "at least 1 x 1 pixels"),
    (lambda: Scene().sample(1, 8), "in whole numbers; got 8"),
    (lambda: capture(X, SHOT, torch.full((1, 4, 2, 2), torch.nan)), "finite"),
    (
        lambda: RANGED.draw(torch.zeros(3, 2, dtype=torch.float64), (4, 4)),
        "takes random numbers of the shape (n, 5), for n images; got (3, 2). Get them from",
    ),
    (lambda: RANGED.draw(torch.zeros(5, dtype=torch.float64), (4, 4)), "(n, 5), for n images; got"),
    (
        lambda: RANGED.draw(torch.tensor([[0.0, -0.5, 0.5, 3.0, 0.0]]), (4, 4)),
        "random numbers to draw from must lie in [0, 1); got -0.5 to 3. Get them from",
    ),
    (lambda: RANGED.draw(torch.full((1, 5), torch.nan), (4, 4)), "must lie in [0, 1); got nan"),
    (lambda: Mixture((RANGED, RANGED)).draw(torch.zeros(1, 7), (4, 4)), "(n, 6), for n images"),
    (lambda: Mixture((RANGED, RANGED)).draw(torch.ones(1, 6), (4, 4)), "[0, 1); got 1 to 1"),
    (lambda: Scene().sample(1, (4, 4), OnGpu()), "got a generator on cuda:0"),
]


MISTAKEN = [
    (lambda: capture(X, Scene()), "a shot must be a Shot; got a Scene"),
    (lambda: engine.explain("screen_photo"), "must be a Scene; got 'screen_photo'. For a preset"),
    (lambda: capture(X, dataclasses.replace(SHOT, scene="paper")), "must be a Scene; got 'pa"),
    (lambda: Scene(lens=Lens(blur="5e-1")), "numbers; got '5e-1'. It is text: write 0.5."),
    (lambda: without_moire("screen_photo"), "a shot must be a Shot; got a str"),
    (lambda: Scene().sample(1, (4, 4), 0), "torch.Generator or None; got 0. For a seed, pass"),
    (lambda: develop(expose(X, SHOT), Scene()), "a shot must be a Shot; got a Scene"),
    (lambda: develop(np.zeros((1, 4, 2, 2)), SHOT), "floating point tensor; got a ndarray"),
    (lambda: Shot.from_dict(None), "a shot's values must be a mapping; got None"),
    *[
        (lambda v=v: changed(panel_scale=[v]), "a shot's panel.scale must be a number; got")
        for v in ([1.0], "1", None, True)
    ],
    (lambda: changed(panel=None), "a shot's panel must be a mapping of its fields; got None"),
    (lambda: Scene(tolerance=(0, 1)), "Scene.tolerance must be a number; got (0, 1)"),
    (lambda: Layout((1, 2)), "Layout.subpixels must be (channel, x0, y0, x1, y1)"),
    (lambda: Scene.from_dict("screen_photo"), "must be a mapping; got 'screen_photo'"),
    (lambda: Scene(view=View(yaw=torch.ones(2))), "View.yaw of a scene must be a number"),
    (lambda: capture(X, SHOT, np.zeros((1, 4, 2, 2))), "noise must be a torch.Tensor; got"),
    (lambda: capture(X, SHOT, [0.0]), "noise must be a torch.Tensor; got"),
    *[
        (lambda t=t: capture(X, SHOT, torch.ones(1, 4, 2, 2, dtype=t)), f"got a tensor of {t}.")
        for t in (torch.complex64, torch.bool)
    ],
    (lambda: SHOT.to_photo(np.zeros((1, 2, 2))), "points must be a torch.Tensor; got ndarray."),
    (lambda: SHOT.to_photo_mask([[1]]), "a mask must be a torch.Tensor; got list. Convert it with"),
    (lambda: MIXED.to_photo([[1.0, 2.0]]), "points must be a torch.Tensor; got list."),
    (lambda: SHOT["view.yaw"], "got 'view.yaw'. Its numbers are fields, such as shot.view.yaw."),
    (lambda: MIXED[True], "a shot is indexed like a batch, by whole numbers, a slice or a mask"),
    (lambda: Scene().sample_track(1, 2, (4, 4), hand=3), "hand must be a Hand"),
    (lambda: SHOT.to("mps"), "need a device with float64, for the geometry; got mps. Move"),
    (lambda: MIXED.to(torch.device("mps", 0)), "need a device with float64"),
]


@pytest.mark.parametrize(("make", "sentence"), MISTAKEN, ids=range(len(MISTAKEN)))
def test_what_is_of_another_kind_is_refused(make, sentence):
    with pytest.raises(TypeError, match=re.escape(sentence)):
        make()


@pytest.mark.parametrize("row", [1, np.int64(1), torch.tensor(1)])
def test_one_row_of_a_shot_is_a_shot(row):
    shot = Scene.preset("screen_photo").sample(3, (4, 4))
    assert len(shot[row]) == 1 and torch.equal(shot[row].seed, shot.seed[1:2])


@pytest.mark.parametrize(("make", "sentence"), REFUSED, ids=range(len(REFUSED)))
def test_what_cannot_be_photographed_is_refused(make, sentence):
    with pytest.raises(ValueError, match=re.escape(sentence)):
        make()
