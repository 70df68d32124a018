"""Screens in rooms: the camera's photo where the screen is, and no moiré where it is not."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from skimage.draw import polygon2mask

from moireaug import Develop, Lens, Panel, Scene, Sensor, capture
from moireaug.mixtures import as_scenes, map_scenes
from moireaug.scene.by_name import with_values
from moireaug.synthesis import Room, screen_in_room

SIZE = (72, 96)
IN_CAMERAS_FRAME = {"develop.registered": False}
LCD = Scene(
    panel=Panel(lit_y=0.6, glare=0.05, black=0.01),
    lens=Lens(blur=0.3),
    sensor=Sensor(pitch=(1.3, 1.7), shrink=(1.0, 3.0), gain=2.5, read_noise=0.01),
    develop=Develop(linear_light=True),
)
BLURRED = with_values(LCD, {"lens.blur": 0.5, "sensor.gain": 2.0})
QUIET = with_values(LCD, {"sensor.read_noise": 0.0, "panel.glare": 0.0, "panel.black": 0.0})
TURNED = with_values(
    QUIET, {"view.yaw": (10.0, 30.0), "view.roll": (-20.0, 20.0), "lens.k1": (0.02, 0.05)}
)
BARE = Room(bezel=0, corner=0, glow=0, reflection=0, blur=0, ambient=1, extent=1)


def seeded(seed=0):
    return torch.Generator().manual_seed(seed)


def random_pictures(n, size=SIZE):
    return torch.rand(n, 3, *size, generator=seeded(7))


@pytest.mark.parametrize("scene", [LCD, [LCD, BLURRED]], ids=["scene", "mixture"])
def test_a_screen_that_fills_the_photo_is_captured(scene):
    shown = random_pictures(6)
    photos, corners, shares = screen_in_room(
        shown, torch.zeros_like(shown), scene, BARE, generator=seeded()
    )
    scenes = map_scenes(as_scenes(scene), lambda one: with_values(one, IN_CAMERAS_FRAME))
    captured = capture(shown, scenes.sample(6, SIZE, seeded()))
    assert torch.allclose(photos, captured, atol=LCD.tolerance)
    height, width = SIZE
    frame = torch.tensor([[0, 0], [width, 0], [width, height], [0, height]]).double()
    assert torch.allclose(corners, frame.expand(6, 4, 2)) and shares.min() > 1 - 1e-6


def test_within_its_edges_a_turned_screen_is_captured():
    shown = random_pictures(4)
    room = screen_in_room(shown, torch.zeros_like(shown), TURNED, BARE, generator=seeded())
    photos = capture(shown, with_values(TURNED, IN_CAMERAS_FRAME).sample(4, SIZE, seeded()))
    for photo, captured, corners in zip(room.photos, photos, room.quadrilaterals, strict=True):
        middle = corners.mean(0)
        inside = polygon2mask(SIZE, (middle + 0.93 * (corners - middle) - 0.5).numpy()[:, ::-1])
        assert inside.mean() > 0.5
        assert torch.allclose(photo[:, inside], captured[:, inside], atol=TURNED.tolerance)


@pytest.mark.parametrize("extent", [0.3, 0.7, 1.2])
def test_the_quadrilateral_and_the_share_are_those_of_the_pixels(extent):
    room = with_extent(extent)
    white, black = torch.ones(4, 3, 30, 50), torch.zeros(4, 3, 150, 200)
    photos, corners, shares = screen_in_room(white, black, TURNED, room, generator=seeded(1))
    for photo, quadrilateral, share in zip(photos, corners, shares, strict=True):
        lit = (photo[1] > 0.3).numpy()
        polygon = polygon2mask(lit.shape, quadrilateral.numpy()[:, ::-1] - 0.5)
        assert (lit & polygon).sum() / (lit | polygon).sum() > 0.94
        assert share == pytest.approx(lit.mean(), abs=0.01)


def with_extent(extent):
    return Room(**{name: getattr(BARE, name) for name in Room.ranged} | {"extent": extent})


def test_there_is_moire_on_the_screen_and_none_around():
    grey = torch.full((3, 3, 60, 80), 0.5)
    around = torch.full((3, 3, *SIZE), 0.5)
    room = Room(extent=0.6, place_x=0.5, place_y=0.5, bezel=0.05, corner=0, glow=0, reflection=0)
    photos, corners, _ = screen_in_room(grey, around, QUIET, room, generator=seeded())
    for photo, quadrilateral in zip(photos, corners, strict=True):
        middle = quadrilateral.mean(0)
        grown, shrunk = (middle + f * (quadrilateral - middle) - 0.5 for f in (1.25, 0.9))
        outside = ~polygon2mask(SIZE, grown.numpy()[:, ::-1])
        inside = polygon2mask(SIZE, shrunk.numpy()[:, ::-1])
        assert photo[:, outside].std(1).max() < 1e-3 < 0.01 < photo[:, inside].std(1).max()


def test_the_room_is_dimmed_lit_and_mirrored():
    def mean_around(**values):
        shown, around = torch.ones(1, 3, *SIZE), torch.full((1, 3, 90, 160), 0.5)
        fixed = {name: getattr(BARE, name) for name in Room.ranged}
        fixed |= {"extent": 0.5, "place_x": 0.0, "ambient": 0.3}
        room = Room(**fixed | values)
        photos = screen_in_room(
            shown * values.pop("code", 1), around, QUIET, room, generator=seeded()
        )[0]
        return photos[..., 100:].mean().item(), photos[..., 10:40].mean().item()

    (dim, screen), (lit, _), (bright, _) = (
        mean_around(),
        mean_around(glow=0.2),
        mean_around(ambient=1),
    )
    assert dim < 0.8 * bright and dim * 1.02 < lit
    assert mean_around(reflection=0.1)[1] >= screen


def test_draws_come_from_the_generator():
    shown, around = random_pictures(3), random_pictures(3, (60, 50))
    first, same, other = (
        screen_in_room(shown, around, "phone_at_laptop", shrink=(1, 3), generator=seeded(seed))
        for seed in (1, 1, 2)
    )
    assert all(map(torch.equal, first, same)) and not torch.equal(first.shares, other.shares)
    assert first.photos.shape == (3, 3, 60, 50) and first.quadrilaterals.shape == (3, 4, 2)
    assert first.photos.min() >= 0 and first.photos.max() <= 1
    empty = screen_in_room(shown[:0], around[:0], "phone_at_laptop", generator=seeded())
    assert empty.photos.shape == (0, 3, 60, 50)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_is_computed_in_single(dtype):
    shown, around = random_pictures(1).to(dtype), random_pictures(1, (60, 50)).to(dtype)
    photos = screen_in_room(shown, around, LCD, generator=seeded()).photos
    wide = screen_in_room(shown.float(), around.float(), LCD, generator=seeded()).photos
    assert photos.dtype == dtype and torch.equal(photos, wide.to(dtype))


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"surroundings": torch.zeros(2, 3, 8, 8)}, ValueError, "got 1 and 2"),
        ({"pictures": torch.zeros(1, 1, 8, 8)}, ValueError, "shape"),
        ({"surroundings": torch.full((1, 3, 8, 8), 255.0)}, ValueError, "Divide them by 255"),
        ({"scene": "paper"}, ValueError, "binned reading"),
        ({"room": {"extent": 1}}, TypeError, r"room must be a moireaug\.synthesis\.Room"),
    ],
)
def test_what_is_no_room_is_refused(changes, error, message):
    arguments = {"pictures": torch.zeros(1, 3, 8, 8), "surroundings": torch.zeros(1, 3, 8, 8)}
    arguments |= {"scene": "phone_at_monitor"} | changes
    with pytest.raises(error, match=message):
        screen_in_room(**arguments)


def test_a_room_out_of_its_bounds_is_refused():
    with pytest.raises(ValueError, match=r"Room\.extent must lie in \[0\.01, 10\]"):
        Room(extent=0)
    assert np.allclose(Room(extent=(0.2, 0.4)).draw(50, seeded())["extent"].mean(), 0.3, atol=0.05)


def test_noise_is_that_of_one_photo_in_every_region():
    """Read noise is as strong on the screen, on the bezel and around; each once counted."""
    noisy = Scene(sensor=Sensor(pitch=1.5, shrink=1.0, gain=0.5, read_noise=0.03))
    room = replace(BARE, extent=0.6, place_x=0.5, place_y=0.5, bezel=0.2)
    room = replace(room, albedo=0.8, reflection=1.0)
    shown, around = (torch.full((2, 3, *SIZE), value) for value in (0.2, 0.5))
    photos, *_ = screen_in_room(shown, around, noisy, room, generator=seeded())
    quiet, *_ = screen_in_room(
        shown, around, with_values(noisy, {"sensor.read_noise": 0.0}), room, generator=seeded()
    )
    noise = photos - quiet
    regions = {"screen": noise[..., 25:47, 35:61], "bezel": noise[..., 25:47, 11:17]}
    regions["around"] = noise[..., :4, :]
    strengths = {name: region.std().item() for name, region in regions.items()}
    assert strengths["around"] > 0.01
    for name, strength in strengths.items():
        assert strength == pytest.approx(strengths["around"], rel=0.2), name
