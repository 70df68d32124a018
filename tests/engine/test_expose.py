"""The engine's exposure equals the reference in float64, on random pictures: the hardest there
are."""

import dataclasses

import pytest
import torch

from moireaug import Develop, Layout, Lens, Panel, Scene, Sensor, View, expose, pipeline
from moireaug.capture import reading_of
from moireaug.effects.prefilter import MAX_NEIGHBOUR_VARIANCE
from moireaug.engine import program
from moireaug.engine.cpu import run
from moireaug.engine.shot_exposure import lower_exposure
from moireaug.scene.presets import PRESETS
from tests.engine.readings import assert_equal, readings

DELTA = Layout(
    ((0, 0, 0, 1.2, 0.5), (1, 0.4, 0.5, 2, 1.0), (2, 1, 1, 1.9, 1.9), (2, 0.1, 1.1, 0.8, 1.8)),
    (2, 2),
)
TURNED = View(yaw=(-25.0, 25.0), pitch=(-15.0, 15.0), roll=(-12.0, 12.0), fov=(20.0, 50.0))
SHARP, SOFT = Lens(), Lens(blur=(0.2, 0.4))
BENT = Lens(k1=(-0.03, 0.05), k2=(-0.02, 0.02), blur=(0.2, 0.4))
TWICE = Sensor(scale=2.0)
SCENES = {
    "frontal": Scene(lens=SOFT, sensor=TWICE),
    "frontal and sharp": Scene(lens=SHARP, sensor=TWICE),
    "turned": Scene(view=TURNED, lens=SOFT, sensor=TWICE),
    "bent": Scene(view=TURNED, lens=BENT, sensor=TWICE),
    "coarse": Scene(panel=Panel(scale=0.6), view=TURNED, lens=BENT, sensor=TWICE),
    "fine": Scene(panel=Panel(scale=1.6), view=TURNED, lens=BENT, sensor=TWICE),
    "one sensor pixel per photo pixel": Scene(view=TURNED, lens=SOFT),
    "three": Scene(panel=Panel(scale=1.7), view=TURNED, lens=SOFT, sensor=Sensor(scale=3.0)),
    "two and a half": Scene(view=TURNED, lens=SOFT, sensor=Sensor(scale=2.5)),
    "no colour filters": Scene(view=TURNED, lens=SOFT, sensor=Sensor(scale=2.0, cfa="none")),
    "camera's frame": Scene(
        view=TURNED, lens=SOFT, sensor=TWICE, develop=Develop(registered=False)
    ),
    "light": Scene(view=TURNED, lens=SOFT, sensor=TWICE, develop=Develop(linear_light=True)),
    "noise": Scene(
        view=TURNED, lens=SOFT, sensor=Sensor(scale=2.0, gain=(2.0, 3.0), read_noise=0.02)
    ),
    "photon noise": Scene(
        view=TURNED, lens=SOFT, sensor=Sensor(scale=2.0, gain=2.0, read_noise=0.01, shot_noise=0.05)
    ),
    "vignetting": Scene(view=TURNED, lens=Lens(vignetting=(0.2, 0.6), blur=0.3), sensor=TWICE),
    "low-pass": Scene(
        view=TURNED, lens=Lens(olpf=(0.3, 0.9), blur=0.2), sensor=Sensor(scale=2.0, fill=(0.5, 1.0))
    ),
    "flicker": Scene(
        panel=Panel(pwm=(200.0, 500.0)),
        lens=SOFT,
        sensor=Sensor(scale=2.0, shutter=(0.001, 0.004), readout=0.03),
    ),
    "flicker and glare": Scene(
        panel=Panel(pwm=200.0, glare=0.3, glare_x=0.2),
        lens=Lens(blur=0.3, vignetting=0.3),
        sensor=Sensor(scale=2.0, gain=1.5, shutter=0.002, readout=0.03),
    ),
    "flicker and glare, point": Scene(
        panel=Panel(pwm=200.0, glare=0.3),
        sensor=Sensor(scale=3.0, exposure="point", shutter=0.002, readout=0.03),
    ),
    "black level": Scene(panel=Panel(black=(0.01, 0.1)), lens=SOFT, sensor=TWICE),
    "black level, light": Scene(
        panel=Panel(black=(0.01, 0.1), scale=0.9),
        lens=SOFT,
        sensor=TWICE,
        develop=Develop(linear_light=True),
    ),
    "black level, prefilter that varies": Scene(
        panel=Panel(black=0.1),
        view=View(yaw=(-25.0, 25.0), zoom=0.12),
        lens=SOFT,
        sensor=TWICE,
        develop=Develop(linear_light=True),
    ),
    "glare": Scene(
        panel=Panel(glare=(0.05, 0.3), glare_x=(-0.5, 0.5), glare_y=(-0.5, 0.5)),
        view=TURNED,
        lens=SOFT,
        sensor=TWICE,
    ),
    "glare, no colour filters": Scene(
        panel=Panel(glare=0.2, glare_x=0.4, glare_y=-0.3, layout=DELTA),
        view=TURNED,
        lens=SOFT,
        sensor=Sensor(scale=2.0, cfa="none", crosstalk=0.1),
    ),
    "crosstalk": Scene(view=TURNED, lens=SOFT, sensor=Sensor(scale=2.0, crosstalk=(0.05, 0.3))),
    "crosstalk, no colour filters": Scene(
        view=TURNED, lens=SOFT, sensor=Sensor(scale=2.0, cfa="none", crosstalk=0.2)
    ),
    "crosstalk, mean": Scene(
        panel=Panel(glare=0.1),
        view=TURNED,
        sensor=Sensor(scale=2.0, crosstalk=0.2, exposure="mean"),
    ),
    "motion": Scene(
        view=TURNED,
        lens=Lens(blur=0.2, motion_x=(-0.8, 0.8), motion_y=(-0.8, 0.8)),
        sensor=TWICE,
    ),
    "motion alone": Scene(lens=Lens(motion_x=0.4), sensor=TWICE),
    "motion that vanishes": Scene(
        panel=Panel(scale=1.2),
        view=View(pitch=22.0, fov=60.0, shift_x=-0.3),
        lens=Lens(motion_y=1.0),
        sensor=Sensor(scale=1.5, cfa="none", exposure="mean", fill=0.3),
    ),
    "motion that vanishes, soft": Scene(
        panel=Panel(scale=1.2),
        view=View(pitch=22.0, fov=60.0, shift_x=-0.3),
        lens=Lens(motion_y=1.0, blur=0.2),
        sensor=Sensor(scale=1.5),
    ),
    "aligned": Scene(panel=Panel(layout="even"), sensor=Sensor(scale=7.0)),
    "aligned, magnified": Scene(panel=Panel(layout="even"), view=View(zoom=25.0)),
    "everything": Scene(
        panel=Panel(black=0.02, glare=0.1, glare_x=0.3, lit=0.7, scale=1.2),
        view=TURNED,
        lens=dataclasses.replace(BENT, motion_x=0.5, motion_y=-0.3, vignetting=0.3),
        sensor=Sensor(scale=2.0, gain=1.5, crosstalk=0.15, read_noise=0.01, shot_noise=0.02),
        develop=Develop(linear_light=True),
    ),
    "black matrix": Scene(panel=Panel(lit=(0.35, 0.9)), view=TURNED, lens=BENT, sensor=TWICE),
    "pentile": Scene(panel=Panel(layout="pentile"), view=TURNED, lens=BENT, sensor=TWICE),
    "diamonds": Scene(panel=Panel(layout="pentile_diamond"), view=TURNED, lens=BENT, sensor=TWICE),
    "led": Scene(panel=Panel(layout="led"), view=TURNED, lens=BENT, sensor=TWICE),
    "delta": Scene(panel=Panel(layout=DELTA), view=TURNED, lens=Lens(blur=0.4), sensor=TWICE),
    "mean": Scene(
        panel=Panel(lit=0.7), view=TURNED, lens=BENT, sensor=Sensor(scale=2.0, exposure="mean")
    ),
    "upside down": Scene(view=View(roll=(150.0, 180.0)), lens=SOFT, sensor=TWICE),
}


@pytest.mark.parametrize("name", SCENES)
def test_equals_the_reference(name):
    assert_equal(*readings(SCENES[name], (40, 52)))


@pytest.mark.parametrize(("lit", "gain"), [(0.2, 100.0), (0.02, 900.0)])
def test_what_is_faint_on_the_panel_is_amplified(lit, gain):
    scene = Scene(
        panel=Panel(layout="led_cob", lit=lit, scale=1.3),
        view=View(roll=3.0, yaw=5.0),
        lens=Lens(blur=0.3),
        sensor=Sensor(scale=2.0, gain=gain),
    )
    shot = scene.sample(1, (48, 48))
    images = torch.full((1, 3, 48, 48), 0.9)
    got = expose(images, shot)
    assert got.std() > 0.02  # it is not saturated
    assert_equal(got.double(), pipeline.expose(images.double(), shot))


@pytest.mark.parametrize("name", [name for name in PRESETS if not name.startswith("paper")])
def test_equals_the_reference_on_every_preset(name):
    assert_equal(*readings(Scene.preset(name), (40, 52), n=4))


@pytest.mark.parametrize(("pitch", "taps"), [(8.0, 3), (1.2, 5), (0.8, 7), (0.3, 7)])
@pytest.mark.parametrize("name", ["turned", "pentile", "camera's frame"])
def test_any_number_of_panel_pixels_in_view(name, pitch, taps):
    scene = SCENES[name]
    scene = dataclasses.replace(scene, panel=dataclasses.replace(scene.panel, scale=2.0 / pitch))
    assert scene.plan().method.taps == taps
    assert_equal(*readings(scene, (24, 32)))


@pytest.mark.parametrize("execution", [expose, pipeline.expose])
def test_stripes_are_stripes_in_any_cell(execution):
    stripes = tuple((c, x + c / 3, 0, x + (c + 1) / 3, 1) for x in range(4) for c in range(3))
    images, readings = torch.rand(2, 3, 40, 52), []
    for layout in ("rgb_stripe", Layout(stripes, (4, 1))):
        scene = dataclasses.replace(SCENES["everything"], panel=Panel(layout=layout, lit=0.6))
        shot = scene.sample(2, (40, 52), torch.Generator().manual_seed(3))
        readings.append(execution(images, shot))
    assert (readings[0] - readings[1]).abs().max() < 1e-5


def random_scene(i):
    """A scene of plain numbers, each anywhere that a camera may be."""
    g = torch.Generator().manual_seed(i)

    def between(low, high):
        return float(low + (high - low) * torch.rand((), generator=g))

    def one_of(*values):
        return values[int(torch.randint(len(values), (), generator=g))]

    return Scene(
        panel=Panel(
            scale=between(0.4, 3),
            layout=one_of("rgb_stripe", "rgb_column", "pentile", "pentile_diamond", "led", DELTA),
            lit=between(0.35, 1),
            lit_x=between(0.7, 1),
            lit_y=between(0.7, 1),
        ),
        view=View(
            yaw=between(-40, 40),
            pitch=between(-30, 30),
            roll=between(-180, 180),
            zoom=between(0.8, 1.5),
        ),
        lens=Lens(k1=between(-0.05, 0.05), blur=between(0.15, 0.6), vignetting=between(0, 0.5)),
        sensor=Sensor(
            scale=one_of(1.0, 1.5, 2.0, 3.0),
            cfa=one_of("rggb", "none"),
            fill=between(0.5, 1),
            gain=between(0.5, 3),
            read_noise=between(0, 0.05),
            shot_noise=between(0, 0.05),
            exposure=one_of("auto", "auto", "mean"),
        ),
        develop=Develop(registered=one_of(True, False), linear_light=one_of(True, False)),
    )


@pytest.mark.parametrize("part", range(10))
def test_random_scenes(part):
    for i in range(5):
        scene = random_scene(5 * part + i)
        shot = scene.sample(1, (14, 19), torch.Generator().manual_seed(i))
        images = torch.rand(1, 3, 14, 19, generator=torch.Generator().manual_seed(i))
        if not program.program_for(images, shot).why_not_expose:
            assert_equal(expose(images, shot).double(), pipeline.expose(images.double(), shot))


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (12, 1), (2, 2), (7, 33), (67, 30)])
@pytest.mark.parametrize(
    "name", ["turned", "light", "no colour filters", "two and a half", "everything"]
)
def test_any_size(name, size):
    assert_equal(*readings(SCENES[name], size))


@pytest.mark.parametrize(("size", "scale"), [((1, 1), 1.0), ((2, 2), 0.7), ((1, 40), 1.0)])
def test_a_single_row_is_where_the_lens_sees_it(size, scale):
    scene = Scene(
        view=View(yaw=30.0, pitch=-35.0, roll=-152.0),
        lens=Lens(k1=0.25),
        sensor=Sensor(scale=scale, cfa="none"),
    )
    assert_equal(*readings(scene, size))


def test_a_batch_of_none():
    shot = SCENES["turned"].sample(0, (8, 8))
    assert expose(torch.rand(0, 3, 8, 8), shot).shape == shot.raw_shape()


@pytest.mark.parametrize("name", ["turned", "light", "black level", "everything"])
def test_bytes_are_read_as_they_are(name):
    shot = SCENES[name].sample(3, (20, 24))
    codes = torch.randint(0, 256, (3, 3, 20, 24), dtype=torch.uint8)
    given = lower_exposure(shot, decoded=False)
    got, expected = (run.expose(c, False, *given)[0] for c in (codes, codes.float() / 255))
    assert (got - expected).abs().max() < 2e-6


def test_bytes_are_read_as_they_are_through_a_prefilter_that_varies():
    shot = SCENES["black level, prefilter that varies"].sample(2, (20, 24))
    assert shot.plan.prefilter_variance > MAX_NEIGHBOUR_VARIANCE
    codes = torch.randint(0, 256, (2, 3, 20, 24), dtype=torch.uint8)
    assert torch.equal(reading_of(codes, shot), reading_of(codes.float() / 255, shot))


def test_threads_and_parts_of_a_batch_change_nothing():
    shot = SCENES["noise"].sample(5, (20, 24))
    images = torch.rand(5, 3, 20, 24)
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        alone = expose(images, shot)
        torch.set_num_threads(3)
        assert torch.equal(alone, expose(images, shot))
    finally:
        torch.set_num_threads(threads)
    assert torch.equal(alone[2:4], expose(images[2:4], shot[2:4]))


@pytest.mark.parametrize(
    "change",
    [
        lambda s: dataclasses.replace(s, lens=dataclasses.replace(s.lens, blur=s.lens.blur * 1.1)),
        lambda s: dataclasses.replace(
            s, panel=dataclasses.replace(s.panel, scale=s.panel.scale * 1.0005)
        ),
        lambda s: dataclasses.replace(s, seed=s.seed + 1),
    ],
    ids=["blur", "pitch", "seed"],
)
def test_another_shot_is_not_equal(change):
    shot = SCENES["noise"].sample(1, (40, 52))
    image = torch.rand(1, 3, 40, 52)
    got, expected = expose(image, change(shot)).double(), pipeline.expose(image.double(), shot)
    with pytest.raises(AssertionError):
        assert_equal(got, expected)
