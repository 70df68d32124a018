"""Scenes at the corners of their ranges, and screens past the horizon: photos are the reference's,
and gradients are finite."""

import pytest
import torch

from moireaug import Develop, Lens, Panel, Scene, Sensor, View, capture, engine
from moireaug.scene.by_name import with_values
from tests.photo_checks import in_range

CORNERS = {  # the ends of what fields may be, and their identity
    "view": {
        "yaw": (-89, 0, 89), "pitch": (-89, 0, 89), "roll": (-180, 0, 45),
        "zoom": (1e-3, 1e-3, 1, 100), "fov": (1, 40, 89), "fit": (True, False),
        "shift_x": (-1, 0, 1), "shift_y": (-1, 0, 1),
    },
    "lens": {
        "k1, k2": ((0, 0), (1, 1), (-0.3, 0), (0, -0.19), (-0.3, 1)), "blur": (0, 0.3, 20),
        "motion_x": (0, 20), "motion_y": (0, -20), "olpf": (0, 4), "vignetting": (0, 0.99),
    },
}  # fmt: skip
PANELS = [{"width": w} for w in (1, 700, 1e5)] + [{"scale": s} for s in (0.3, 2, 1e5)]
CORNER_SIZES = [(9, 21), (1, 1), (1, 33), (24, 2)]


def corner(i):
    """A scene at a corner of its ranges, and a picture's size: each drawn."""
    g = torch.Generator().manual_seed(i)

    def one_of(values):
        return values[int(torch.randint(len(values), (), generator=g))]

    parts = {}
    for part, fields in CORNERS.items():
        drawn = {name: one_of(values) for name, values in fields.items()}
        if "k1, k2" in drawn:
            drawn["k1"], drawn["k2"] = drawn.pop("k1, k2")
        parts[part] = drawn
    panel = one_of(PANELS)
    pitch = {"pitch": one_of((1e-3, 1.7, 1e3))} if "width" in panel else {}
    scene = Scene(
        panel=Panel(**panel), view=View(**parts["view"]), lens=Lens(**parts["lens"]),
        sensor=Sensor(**pitch, cfa=one_of(("rggb", "none"))),
        develop=Develop(registered=one_of((True, False))),
    )  # fmt: skip
    return scene, one_of(CORNER_SIZES)


def faraway(panel, pitch, yaw, tilt):
    """A tiny screen at a grazing angle, in the camera's frame."""
    return Scene(
        panel=panel, view=View(yaw=yaw, pitch=tilt, zoom=1e-3), sensor=Sensor(pitch=pitch),
        develop=Develop(registered=False),
    )  # fmt: skip


FARAWAY = {
    "binned": faraway(Panel(width=700), 1.7, -89, -89),
    "binned, other side": faraway(Panel(width=700), 1.7, 89, 89),
    "full": faraway(Panel(scale=2), 0, 89, 89),
    "full, upright": faraway(Panel(scale=2), 0, 89, 0),
}


def check_photo_and_gradients(scene, size):
    """Return the engine's photo of noise, after checks that it is in [0, 1] and the reference's,
    and that the gradients in picture and shot are finite."""
    shot = scene.sample(1, size, torch.Generator().manual_seed(1))
    image = torch.rand(1, 3, *size, requires_grad=True)
    photo = capture(image, shot)
    leaves = [values.clone().requires_grad_() for values in shot.numbers().values()]
    moved = with_values(shot, dict(zip(shot.numbers(), leaves, strict=True)))
    again = capture(image, moved)
    assert in_range(photo, image) and in_range(again, image)
    with torch.no_grad(), engine.reference():
        assert (photo - capture(image, shot)).abs().max() < 1e-3
    found = torch.autograd.grad(photo.sum(), image)
    found += torch.autograd.grad(again.sum(), (image, *leaves), allow_unused=True)
    assert all(g.isfinite().all() for g in found if g is not None)
    return photo.detach()


@pytest.mark.parametrize("name", FARAWAY)
def test_rays_past_the_horizon_of_a_tiny_screen_see_the_dark(name):
    for size in CORNER_SIZES[:3]:
        photo = check_photo_and_gradients(FARAWAY[name], size)
        assert photo.mean() < 0.02


@pytest.mark.parametrize("first", range(0, 48, 8))
def test_every_corner_of_the_ranges_is_finite(first):
    for i in range(first, first + 8):
        check_photo_and_gradients(*corner(i))
