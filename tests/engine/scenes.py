"""Scenes with what a camera and a screen may do, of full readings but for the last."""

import dataclasses

import torch

from moireaug import Develop, Layout, Lens, Panel, Scene, Sensor, View
from moireaug.scene.by_name import with_values

DELTA = Layout(
    ((0, 0, 0, 1.2, 0.5), (1, 0.4, 0.5, 2, 1.0), (2, 1, 1, 1.9, 1.9), (2, 0.1, 1.1, 0.8, 1.8)),
    (2, 2),
)
TURNED = View(yaw=(-25.0, 25.0), pitch=(-15.0, 15.0), roll=(-12.0, 12.0), fov=(20.0, 50.0))
SOFT = Lens(blur=(0.2, 0.4))
BENT = Lens(k1=(-0.03, 0.05), k2=(-0.02, 0.02), blur=(0.2, 0.4))
LIGHT = Develop(linear_light=True)


def scene(panel=None, view=TURNED, lens=SOFT, develop=None, **sensor):
    """A scene of two sensor pixels a photo pixel, unless `sensor` says otherwise."""
    parts = {"panel": panel or Panel(), "develop": develop or Develop()}
    return Scene(view=view, lens=lens, sensor=Sensor(**{"scale": 2.0, **sensor}), **parts)


BEHIND = View(pitch=22.0, fov=60.0, shift_x=-0.3)
ROWS = {"shutter": 0.002, "readout": 0.03}
SCENES = {
    "turned": scene(),
    "bent": scene(lens=BENT),
    "coarse": scene(Panel(scale=0.6), lens=BENT),
    "three": scene(Panel(scale=1.7), scale=3.0),
    "two and a half": scene(scale=2.5),
    "no colour filters": scene(cfa="none"),
    "camera's frame": scene(develop=Develop(registered=False)),
    "light": scene(develop=LIGHT),
    "noise": scene(gain=(2.0, 3.0), read_noise=0.02),
    "photon noise": scene(gain=2.0, read_noise=0.01, shot_noise=0.05),
    "low-pass": scene(lens=Lens(olpf=(0.3, 0.9), blur=0.2), fill=(0.5, 1.0)),
    "flicker and glare": scene(
        Panel(pwm=200.0, glare=0.3, glare_x=0.2), View(), Lens(blur=0.3, vignetting=0.3), gain=1.5,
        **ROWS,
    ),
    "flicker and glare, point": scene(
        Panel(pwm=200.0, glare=0.3), View(), Lens(), scale=3.0, exposure="point", **ROWS
    ),
    "black level": scene(Panel(black=(0.01, 0.1)), View()),
    "black level, light": scene(Panel(black=(0.01, 0.1), scale=0.9), View(), develop=LIGHT),
    "black level, prefilter that varies": scene(
        Panel(black=0.1), View(yaw=(-25.0, 25.0), zoom=0.12), develop=LIGHT
    ),
    "glare, no colour filters": scene(
        Panel(glare=0.2, glare_x=0.4, glare_y=-0.3, layout=DELTA), cfa="none", crosstalk=0.1
    ),
    "crosstalk": scene(crosstalk=(0.05, 0.3)),
    "crosstalk, mean": scene(Panel(glare=0.1), lens=Lens(), crosstalk=0.2, exposure="mean"),
    "motion": scene(lens=Lens(blur=0.2, motion_x=(-0.8, 0.8), motion_y=(-0.8, 0.8))),
    "motion alone": scene(view=View(), lens=Lens(motion_x=0.4)),
    "motion that vanishes": scene(
        Panel(scale=1.2), BEHIND, Lens(motion_y=1.0), scale=1.5, cfa="none", exposure="mean",
        fill=0.3,
    ),
    "motion that vanishes, soft": scene(
        Panel(scale=1.2), BEHIND, Lens(motion_y=1.0, blur=0.2), scale=1.5
    ),
    "aligned": scene(Panel(layout="even"), View(), Lens(), scale=7.0),
    "aligned, magnified": scene(Panel(layout="even"), View(zoom=25.0), Lens(), scale=1.0),
    "everything": scene(
        Panel(black=0.02, glare=0.1, glare_x=0.3, lit=0.7, scale=1.2),
        lens=dataclasses.replace(BENT, motion_x=0.5, motion_y=-0.3, vignetting=0.3), develop=LIGHT,
        gain=1.5, crosstalk=0.15, read_noise=0.01, shot_noise=0.02,
    ),
    "pentile": scene(Panel(layout="pentile"), lens=BENT),
    "diamonds": scene(Panel(layout="pentile_diamond"), lens=BENT),
    "mean": scene(Panel(lit=0.7), lens=BENT, exposure="mean"),
}  # fmt: skip


def random_scene(i):
    """A scene of plain numbers, each anywhere that a camera may be."""
    g = torch.Generator().manual_seed(i)

    def between(low, high):
        return float(low + (high - low) * torch.rand((), generator=g))

    def one_of(*values):
        return values[int(torch.randint(len(values), (), generator=g))]

    layouts = "rgb_stripe", "rgb_column", "pentile", "pentile_diamond", "led", DELTA
    panel = Panel(
        scale=between(0.4, 3), layout=one_of(*layouts), lit=between(0.35, 1),
        lit_x=between(0.7, 1), lit_y=between(0.7, 1),
    )  # fmt: skip
    view = View(
        yaw=between(-40, 40), pitch=between(-30, 30), roll=between(-180, 180),
        zoom=between(0.8, 1.5),
    )  # fmt: skip
    lens = Lens(k1=between(-0.05, 0.05), blur=between(0.15, 0.6), vignetting=between(0, 0.5))
    sensor = Sensor(
        scale=one_of(1.0, 1.5, 2.0, 3.0), cfa=one_of("rggb", "none"), fill=between(0.5, 1),
        gain=between(0.5, 3), read_noise=between(0, 0.05), shot_noise=between(0, 0.05),
        exposure=one_of("auto", "auto", "mean"),
    )  # fmt: skip
    develop = Develop(registered=one_of(True, False), linear_light=one_of(True, False))
    return Scene(panel=panel, view=view, lens=lens, sensor=sensor, develop=develop)


def random_binned_scene(i):
    """A `random_scene` of a binned reading: of a whole picture, a crop of a screen or a crop of an
    object in turn."""
    scene = random_scene(i)
    width, pitch, shrink = 20 * scene.panel.scale, 2 * scene.panel.scale, scene.sensor.scale
    stated = (
        {"panel.width": width, "sensor.pitch": pitch},
        {"sensor.pitch": pitch, "sensor.shrink": shrink},
        {"panel.width": width, "sensor.shrink": shrink},
    )[i % 3]
    rest = {"panel.scale": 1.0, "sensor.scale": 1.0, "sensor.gain": min(scene.sensor.gain, 1.5)}
    rest |= {"develop.resize": ("area", "point", "antialias")[i // 3 % 3]}
    return with_values(scene, rest | stated)
