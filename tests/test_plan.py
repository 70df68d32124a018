"""Plan: an effect at its identity, or below the tolerance, is absent; the rest say why they are
there."""

import dataclasses
import json

import pytest
import torch

from moireaug import Develop, Lens, Panel, Scene, Sensor, View
from moireaug.scene.layout import Layout
from moireaug.scene.presets import PRESETS

EVEN, COLOUR = Panel(layout="even"), Sensor(cfa="none")
BARE = Scene(panel=EVEN, sensor=COLOUR)  # the photo is the image
OWN = Scene(panel=Panel(layout=Layout(((0, 0, 0, 0.5, 1), (1, 0.5, 0, 1, 1)))))


def colour(**fields):
    return Sensor(cfa="none", **fields)


def even(**fields):
    return {"panel": Panel(layout="even", **fields)}


LIGHT = {"develop": Develop(linear_light=True)}
CALLED = {  # by each of these changes
    "decode": [LIGHT],
    "black_level": [even(black=0.001) | LIGHT, even(black=(0.0, 0.01))],
    "prefilter": [{"lens": Lens(blur=3.0)}, {"view": View(zoom=0.1)}, {"view": View(yaw=80.0)}],
    "layout": [{"panel": Panel()}, even(lit=0.5), even(lit_x=0.5), even(lit_y=(0.5, 1.0))],
    "pose": [{"view": view} for view in (View(yaw=(0, 1)), View(zoom=0.9), View(shift_x=0.1))],
    "lens": [{"lens": Lens(k1=0.01)}, {"lens": Lens(k2=(-0.01, 0))}],
    "crosstalk": [{"sensor": colour(crosstalk=(0.0, 0.1))}],
    "exposure": [
        {"sensor": Sensor()}, {"panel": Panel()}, {"lens": Lens(olpf=0.5)},
        {"lens": Lens(blur=0.6)}, {"lens": Lens(motion_x=0.5)},
        {"lens": Lens(motion_y=(-0.5, 0.0))}, {"sensor": colour(crosstalk=0.1)},
    ],
    "glare": [
        even(glare=0.05), even(glare=0.001) | LIGHT,
        # too little in the middle of the photo, enough in a corner
        even(glare=0.0019, glare_x=0.3, glare_y=(-0.3, 0.0)),
    ],
    "vignetting": [{"lens": Lens(vignetting=(0, 0.1))}],
    "flicker": [even(pwm=240.0) | {"sensor": colour(shutter=0.001, readout=0.01)}],
    "gain": [{"sensor": colour(gain=0.5)}],
    "noise": [{"sensor": colour(read_noise=(0, 0.1))}, {"sensor": colour(shot_noise=0.01)}],
    "saturate": [
        {"sensor": colour(gain=(0.5, 1.5))}, even(pwm=240.0) | {"sensor": colour(shutter=0.001)},
        even(glare=0.05),
    ],
    "bits": [{"sensor": colour(bits=6)}],
    "demosaic": [{"sensor": Sensor()}],
    "resize": [{"sensor": colour(scale=2)}],
    "balance": [{"develop": Develop(red=1.1)}, {"develop": Develop(blue=(0.9, 1.0))}],
    "colour_matrix": [
        {"sensor": colour(crosstalk=0.1)}, {"develop": Develop(saturation=(0.9, 1.0))}
    ],
    "encode": [LIGHT],
    "tone_curve": [
        {"develop": Develop(contrast=(-0.2, 0.0))}, {"develop": Develop(shoulder=(0.0, 0.3))}
    ],
    "brighten": [{"develop": Develop(brighten=0.1)}],
    "denoise": [{"develop": Develop(denoise="bilateral")}],
    "chroma_blur": [{"develop": Develop(chroma_blur=(0.0, 0.5))}],
    "sharpen": [{"develop": Develop(sharpen=0.5)}],
    "register": [{"view": View(roll=5)}],
    "jpeg": [{"develop": Develop(jpeg=(1, 90))}],
}  # fmt: skip


@pytest.mark.parametrize("effect", CALLED)
def test_an_effect_is_there_when_and_only_when_called_for(effect):
    assert effect not in BARE.plan()
    for change in CALLED[effect]:
        plan = dataclasses.replace(BARE, **change).plan()
        reasons = plan.to_dict()
        assert effect in plan, change
        assert reasons["effects"][effect] and effect not in reasons["left_out"]


NOT_CALLED = [
    ("flicker", even(pwm=240.0)),  # no shutter
    ("flicker", even(pwm=240.0, duty=1.0) | {"sensor": colour(shutter=0.001)}),
    ("register", {"view": View(roll=5), "develop": Develop(registered=False)}),
    ("saturate", {"sensor": colour(gain=0.5)}),
    ("saturate", even(glare=0.05) | {"sensor": colour(gain=0.5)}),
    ("layout", {"panel": Panel(), "lens": Lens(blur=3.0)}),
    # the slope of a light that is not there, the radius of a mask that is not applied
    ("glare", even(glare_x=0.5, glare_y=-0.5)),
    ("sharpen", {"develop": Develop(sharpen_radius=5.0)}),
    # a coarse panel shows the picture averaged
    ("prefilter", even(scale=0.1)),
    ("prefilter", even(scale=0.1) | {"sensor": colour(exposure="point")}),
    # the exposure counts the panel pixels that it spreads over
    ("prefilter", {"lens": Lens(blur=0.6)}),
    ("prefilter", {"view": View(zoom=0.1), "sensor": colour(exposure="supersample:2")}),
]


@pytest.mark.parametrize(("effect", "change"), NOT_CALLED)
def test_an_invisible_effect_is_not_called_for(effect, change):
    plan = dataclasses.replace(BARE, **change).plan()
    assert effect not in plan and plan.to_dict()["left_out"][effect]


def test_a_scene_without_effects_returns_its_input(images):
    assert BARE.plan().called == ()
    images[0, :, 0, :2] = torch.tensor([0.0, 1.0])
    for dtype in (torch.float16, torch.bfloat16, torch.float32, torch.float64):
        image = images.to(dtype)
        photo = BARE.capture(image)
        assert photo.dtype == dtype and torch.equal(photo, image)


def test_light_meets_the_effects_in_one_order():
    """Noise before the well is full, codes before the resize: the order is the physics. Every
    effect has a scene that calls for it."""
    order = (
        "decode black_level prefilter layout pose lens crosstalk exposure flicker glare vignetting "
        "gain noise saturate bits demosaic balance colour_matrix encode tone_curve brighten "
        "denoise chroma_blur sharpen resize register jpeg"
    )
    steps = BARE.plan().steps
    assert [step.name for step in steps] == order.split() and all(step.reason for step in steps)
    assert CALLED.keys() == set(order.split())


@pytest.mark.parametrize(
    "scene", [*map(Scene.preset, PRESETS), BARE, OWN], ids=[*PRESETS, "bare", "own layout"]
)
def test_a_plan_is_plain_data(scene):
    values = scene.plan().to_dict()
    assert json.loads(json.dumps(values)) == values
    assert set(values["effects"]) ^ set(values["left_out"]) == {s.name for s in scene.plan().steps}


def test_a_magnified_screen_is_integrated_in_closed_form():
    for pitch, exposure in ((4, "spectral"), (200, "box")):
        scene = Scene(panel=Panel(scale=2 / pitch), sensor=Sensor(scale=2))
        assert scene.plan().exposure == exposure
