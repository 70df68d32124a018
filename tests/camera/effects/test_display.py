"""What a display adds: black that emits, and glare, which has neither subpixels nor moiré."""

import dataclasses

import pytest
import torch

from moireaug import Develop, Layout, Lens, Panel, Scene, Sensor, View, expose
from moireaug.camera import pipeline
from moireaug.camera.effects.light import glare_share
from moireaug.camera.exposure.extremes import max_glare
from moireaug.scene.by_name import with_values
from moireaug.scene.geometry.lattice import pack

EVEN = Panel(layout="even")
STRIPES = Scene(panel=Panel(scale=1.1), lens=Lens(blur=0.3), sensor=Sensor(scale=2.0))
UNEVEN = Layout(((0, 0.0, 0.0, 0.5, 1.0), (1, 0.5, 0.0, 1.0, 0.4), (2, 0.5, 0.5, 0.9, 1.0)))
CFAS = ["rggb", "none"]


def read(scene, level=0.5, size=(24, 32)):
    """The raw reading of a flat screen, (planes, h, w) float64."""
    image = torch.full((1, 3, *size), level, dtype=torch.float64)
    return expose(image, scene.sample(1, size))[0]


@pytest.mark.parametrize("linear_light", [False, True])
def test_black_emits_and_white_stays_what_it_is(linear_light):
    scene = Scene(panel=EVEN, develop=Develop(linear_light=linear_light))
    lit = with_values(scene, {"panel.black": 0.1})
    assert torch.allclose(read(lit, 0.0), torch.full((), 0.1).double(), atol=1e-9)
    assert torch.allclose(read(lit, 1.0), read(scene, 1.0), atol=1e-9)
    # between them it is a line in light, whatever the codes are
    expected = 0.1 + 0.9 * read(scene, 0.6)
    assert torch.allclose(read(lit, 0.6), expected, atol=1e-9)


def test_black_light_has_the_panels_subpixels():
    """Unlike glare: a black screen that leaks shows a white one's moiré, as far as it leaks."""
    leaking = read(with_values(STRIPES, {"panel.black": 0.2}), 0.0)
    assert torch.allclose(leaking, 0.2 * read(STRIPES, 1.0), atol=1e-9)
    assert leaking.std((1, 2)).min() > 0.005


@pytest.mark.parametrize("cfa", CFAS)
@pytest.mark.parametrize("level", [0.0, 0.5])
def test_glare_adds_the_same_to_every_pixel(cfa, level):
    """That share of what the plane reads of a white screen on average, and no moiré."""
    scene = with_values(STRIPES, {"sensor.cfa": cfa})
    added = read(with_values(scene, {"panel.glare": 0.3}), level) - read(scene, level)
    assert torch.allclose(added, torch.full((), 0.3 / 3).double(), atol=1e-12)
    mean = with_values(scene, {"sensor.exposure": "mean"})
    assert read(mean, 1.0).mean().item() == pytest.approx(1 / 3)
    assert read(scene, 1.0).std((1, 2)).min() > 0.03  # negative control: the screen has moiré


@pytest.mark.parametrize("cfa", CFAS)
def test_glare_is_a_share_of_each_planes_white(cfa):
    """With a black matrix, colours of several sizes, and filters that overlap."""
    panel = Panel(layout=UNEVEN, lit=0.6, lit_x=0.9)
    scene = Scene(panel=panel, sensor=Sensor(cfa=cfa, crosstalk=0.2, exposure="mean"))
    black, white = read(with_values(scene, {"panel.glare": 0.25}), 0.0), read(scene, 1.0)
    assert torch.allclose(black, 0.25 * white, atol=1e-9)
    assert white.mean((1, 2)).std() > 0.01


@pytest.mark.parametrize("cfa", CFAS)
@pytest.mark.parametrize("turned", [0.0, 30.0])
def test_glares_slope_is_linear_over_the_photo(cfa, turned):
    """A pixel at the right edge gets 1 + glare_x of it, one at the lower edge 1 + glare_y, however
    the screen is turned."""
    h, w = 24, 32
    panel = Panel(layout="even", glare=0.2, glare_x=0.4, glare_y=-0.1)
    sensor, develop = Sensor(scale=2.0, cfa=cfa), Develop(registered=False)
    scene = Scene(panel=panel, view=View(roll=turned), sensor=sensor, develop=develop)
    added = read(scene, 0.0, (h, w))
    rows, cols = ((torch.arange(2 * n, dtype=torch.float64) + 0.5) / n - 1 for n in (h, w))
    plane = 0.2 * (1 + 0.4 * cols - 0.1 * rows[:, None])
    expected = plane.expand(3, -1, -1) if cfa == "none" else pack(plane[None])[0]
    assert torch.allclose(added, expected, atol=1e-9)


def test_no_glare_is_brighter_than_the_plan_expects():
    """In a corner, where its slopes meet."""
    panel = Panel(layout="even", glare=(0.0, 0.2), glare_x=(-0.5, 0.1), glare_y=(-0.2, 0.4))
    most = max_glare(Scene(panel=panel))
    steepest = dataclasses.replace(panel, glare=0.2, glare_x=-0.5, glare_y=0.4)
    ends = torch.tensor([0.0, 1.0], dtype=torch.float64)
    shot = Scene(panel=steepest).sample(1, (1, 1))
    light = glare_share(ends, ends[:, None], (1, 1), shot.panel)
    assert most == pytest.approx(light.max().item()) and most == pytest.approx(0.38)


def test_glare_comes_before_vignetting_gain_and_a_full_well():
    base = with_values(Scene(panel=EVEN), {"panel.glare": 0.5})
    dimmed = with_values(base, {"lens.vignetting": 0.5, "sensor.gain": 0.5})
    without = read(with_values(dimmed, {"panel.glare": 0.0}), 1.0)
    assert torch.allclose(read(dimmed, 1.0), 1.5 * without, atol=1e-9)
    assert (read(base, 0.9) == 1).all()  # 0.9 + 0.5


def test_gradients_of_light_and_fields():
    scene = Scene(
        panel=Panel(black=0.1, glare=0.2, glare_x=0.1, glare_y=-0.3), sensor=Sensor(crosstalk=0.1)
    )
    shot = scene.sample(1, (2, 3))
    names = "panel.black", "panel.glare", "panel.glare_x", "panel.glare_y"

    def reading(image, *values):
        return expose(image, with_values(shot, dict(zip(names, values, strict=True))))

    image = torch.rand(1, 3, 2, 3, dtype=torch.float64) * 0.5 + 0.2
    given = image, *(shot.numbers()[name].clone() for name in names)
    assert torch.autograd.gradcheck(reading, [values.requires_grad_() for values in given])


def test_the_room_does_not_flicker_with_the_panel():
    scene = Scene(
        panel=Panel(layout="even", glare=0.5, pwm=100.0, duty=0.1, phase=0.0),
        sensor=Sensor(cfa="none", shutter=1e-3, readout=0.02),
    )
    black, white = torch.zeros(1, 3, 32, 32), torch.ones(1, 3, 32, 32)
    shot = scene.sample(1, (32, 32))
    assert "flicker" in scene.plan() and "glare" in scene.plan()
    for photographed in (expose, pipeline.expose):
        assert (photographed(black, shot) - 0.5).abs().max() < 1e-6
        assert photographed(white, shot).std() > 0.2  # the panel does
