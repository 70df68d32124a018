"""Scenes of full readings, with what a camera and a screen may do."""

import dataclasses

import torch

from moireaug import Develop, Layout, Lens, Panel, Scene, Sensor, View

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
