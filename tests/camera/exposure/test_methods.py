"""Every method on layouts of one's own: slanted ones, single colours, panels with gaps."""

import dataclasses
import math

import pytest
import torch

from moireaug import Develop, Lens, Panel, Scene, Sensor, View, capture, expose
from moireaug.camera import pipeline
from moireaug.camera.exposure.full import in_bands
from moireaug.camera.exposure.screen import Screen
from moireaug.scene.layout import Layout

OWN = Layout(((0, 0.0, 0.0, 0.5, 1.0), (1, 0.5, 0.0, 1.0, 0.4), (2, 1.25, 0.5, 1.75, 1.0)), (2, 1))
# the same rectangles by their centres and edges
BY_EDGES = (
    (0, 0.25, 0.5, 0.5, 0, 0, 1),
    (1, 0.75, 0.2, 0.5, 0, 0, 0.4),
    (2, 1.5, 0.75, 0.5, 0, 0, 0.5),
)
SAME = Layout(BY_EDGES, (2, 1))
RED_AND_GREEN = ((0, 0.5, 0.5, 0.4, 0.2, -0.1, 0.6), (1, 0.9, 0.1, 0.3, 0.0, 0.2, 0.5))
SLANTED = Layout((*RED_AND_GREEN, (2, 0.5, 0.5, 0.5, 0.5, -0.5, 0.5)))
RED_ONLY = Layout(((0, 0.0, 0.0, 0.5, 1.0),))
METHODS = ("spectral", "box", "mean", "point", "supersample:3")


@pytest.mark.parametrize("exposure", ["auto", *METHODS])
@pytest.mark.parametrize("cfa", ["rggb", "none"])
def test_a_colour_that_a_layout_lacks_is_dark(cfa, exposure, images):
    sensor = Sensor(scale=2.0, cfa=cfa, exposure=exposure)
    scene = Scene(panel=Panel(layout=RED_ONLY), view=View(roll=5.0), sensor=sensor)
    shot = scene.sample(4, (24, 32))
    raw = expose(images, shot)
    assert (raw[:, 1:] == 0).all() and raw[:, 0].mean() > 0.1
    photo = capture(images, shot)
    assert (photo[:, 1:] == 0).all() and photo.isfinite().all()


def seen(layout, exposure, picture, scale=1.3, **panel):
    """The raw reading of a picture from an oblique view."""
    scene = Scene(
        panel=Panel(layout=layout, scale=scale, **panel),
        view=View(yaw=20, roll=8),
        lens=Lens(blur=0.3, k1=0.03),
        sensor=Sensor(scale=2.0, exposure=exposure),
    )
    shot = scene.sample(len(picture), tuple(picture.shape[-2:]), torch.Generator().manual_seed(0))
    return expose(picture, shot)


@pytest.mark.parametrize("exposure", METHODS)
def test_a_rectangle_given_as_a_parallelogram_is_the_rectangle(exposure, images):
    for picture in (images[:1], images[:1].double()):
        assert torch.equal(*(seen(layout, exposure, picture) for layout in (OWN, SAME)))


def off(series, brute):
    return float((series - brute).square().mean().sqrt() / brute.mean())


def test_brute_force_converges_to_the_series_of_slanted_subpixels():
    """On a white screen so near that its subpixels are seen."""
    white = torch.ones(1, 3, 8, 8, dtype=torch.float64)
    few, many = (seen(SLANTED, f"supersample:{n}", white, scale=0.6) for n in (3, 24))
    series = seen(SLANTED, "spectral", white, scale=0.6)
    assert off(series, many) < 0.02 and off(series, many) < off(series, few) / 4
    # negative control: a slant the other way
    others = [(c, cx, cy, ax, -ay, -dx, dy) for c, cx, cy, ax, ay, dx, dy in SLANTED.subpixels]
    assert off(seen(Layout(tuple(others)), "spectral", white, scale=0.6), many) > 0.04


# centre and edges of rectangles, in a cell of two by one panel pixels
RECTANGLES = {
    "inside": (1.0, 0.5, 0.5, 0.0, 0.0, 0.75),
    "over the left edge": (0.125, 0.5, 0.5, 0.0, 0.0, 0.75),
    "over the upper edge": (1.0, 0.125, 0.5, 0.0, 0.0, 0.75),
    "over the lower right corner": (1.875, 0.875, 0.5, 0.0, 0.0, 0.75),
    "edges to the left and up": (1.0, 0.5, -0.5, 0.0, 0.0, -0.75),
}


@pytest.mark.parametrize("name", RECTANGLES)
def test_points_find_a_rectangle_wherever_it_lies(name):
    """Over whole cells, sampled at every eighth of a panel pixel, the light is the area."""
    layout = Layout(((0, *RECTANGLES[name]),), (2, 1))
    panel, sensor = Panel(layout=layout), Sensor(scale=8.0, cfa="none", exposure="point")
    shot = Scene(panel=panel, sensor=sensor).sample(1, (6, 6))
    for execution in (expose, pipeline.expose):
        light = execution(torch.ones(1, 3, 6, 6), shot).mean((0, 2, 3))
        assert light.tolist() == pytest.approx([0.5 * 0.75 / 2, 0, 0], abs=1e-6)


@pytest.mark.parametrize("exposure", METHODS)
def test_a_lit_area_is_its_two_sides(exposure, images):
    """lit = 0.64 is lit_x = lit_y = 0.8; and points, which have no area, are dimmed by it alike."""
    picture = images.double()
    area = seen("rgb_stripe", exposure, picture, lit=0.64)
    sides = seen("rgb_stripe", exposure, picture, lit_x=0.8, lit_y=0.8)
    assert torch.allclose(sides, area, atol=1e-12)
    other = seen("rgb_stripe", exposure, picture, lit_x=0.64)
    assert torch.allclose(other.mean(), area.mean(), rtol=0.1)
    if exposure not in ("mean", "point"):
        assert not torch.allclose(other, area, atol=0.01)


@pytest.mark.parametrize("exposure", ["spectral", "box", "mean"])
def test_a_narrowed_view_sees_as_much_of_a_small_picture_as_the_whole(exposure):
    """In the camera's frame, from so far that the picture is a third of a sensor pixel, wherever
    that pixel lies."""
    parts = {"view": View(zoom=0.03, fit=False), "develop": Develop(registered=False)}
    for size in ((12, 12), (13, 13)):
        sensor = Sensor(cfa="none", exposure=exposure)
        scene = Scene(panel=Panel(layout="even"), sensor=sensor, **parts)
        raw = expose(torch.ones(1, 3, *size, dtype=torch.float64), scene.sample(1, size))
        assert raw.sum().item() == pytest.approx(3 * size[0] * size[1] * 0.03**2, rel=0.01)
        assert raw.max() < 0.2


def test_mean_is_the_same_camera_without_moire(images):
    """The mean of a screen is what its moiré is around."""
    picture = torch.full_like(images, 0.9).double()
    with_moire = seen("rgb_stripe", "spectral", picture)
    without = seen("rgb_stripe", "mean", picture)
    assert without.std() < 1e-12 < 0.01 < with_moire.std()
    assert with_moire.mean().item() == pytest.approx(without.mean().item(), rel=0.01)


def test_a_panel_of_more_pixels_than_are_looked_at_is_not_built(images, monkeypatch):
    """Where both ways are open they show one thing."""
    view, develop = View(yaw=20, roll=8, zoom=0.8), Develop(registered=False)
    scene = Scene(panel=Panel(scale=1.3), view=view, develop=develop)
    shot, picture = scene.sample(4, (24, 32)), images.double()
    built = expose(picture, shot)
    with monkeypatch.context() as patch:  # a panel that counts as too large
        patch.setattr(Screen, "look", Screen._on_picture)
        assert torch.allclose(expose(picture, shot), built, atol=1e-12)

    def refuse(*_):
        raise AssertionError("the panel was built")

    monkeypatch.setattr("moireaug.camera.exposure.screen.on_panel", refuse)
    expose(picture, Scene(panel=Panel(scale=1000.0)).sample(4, (24, 32)))
    with pytest.raises(AssertionError):
        expose(picture, shot)


@pytest.mark.parametrize("n", [1, 3])
def test_a_point_between_two_subpixels_is_in_one_of_them(n):
    """From in front, the middle of a sensor pixel may lie on a border of panel pixels."""
    sensor = Sensor(cfa="none", exposure=f"supersample:{n}")
    scene = Scene(panel=Panel(layout="even", scale=2.0), sensor=sensor)
    assert torch.allclose(scene.capture(torch.ones(1, 3, 4, 4)), torch.ones(1, 3, 4, 4))


@pytest.mark.parametrize("exposure", ["spectral", "box", "mean"])
def test_light_past_the_taps_is_not_lost(exposure):
    """On a white screen without stripes every reading is 1, however far its view reaches."""
    parts = {"panel": Panel(layout="even"), "sensor": Sensor(cfa="none", exposure=exposure)}
    for blur in (0.0, 0.6, 3.0):
        scene = Scene(view=View(roll=20), lens=Lens(blur=blur), **parts)
        raw = expose(torch.ones(1, 3, 8, 8, dtype=torch.float64), scene.sample(1, (8, 8)))
        assert (raw - 1).abs().max() < 1e-5


MOVED = Lens(blur=0.3, motion_x=0.5, motion_y=-0.3)


def of_white(exposure, lens=MOVED, crosstalk=0.2):
    """The reading of a white screen through overlapping filters, from an oblique view."""
    sensor = Sensor(scale=2.0, crosstalk=crosstalk, exposure=exposure)
    scene = Scene(panel=Panel(scale=0.6), view=View(yaw=20, roll=8), lens=lens, sensor=sensor)
    return expose(torch.ones(1, 3, 6, 6, dtype=torch.float64), scene.sample(1, (6, 6)))


def test_brute_force_converges_to_the_series_with_motion_and_crosstalk():
    series, brute = of_white("spectral"), of_white("supersample:24")
    assert off(series, brute) < 0.03
    assert off(series, brute) < off(series, of_white("supersample:3")) / 4
    # negative controls: the other diagonal, no motion, and filters that overlap less
    mirrored = dataclasses.replace(MOVED, motion_y=0.3)
    assert off(of_white("spectral", mirrored), brute) > 0.06
    assert off(of_white("spectral", Lens(blur=0.3)), brute) > 0.06
    assert off(of_white("spectral", crosstalk=0.1), brute) > 0.06


@pytest.mark.parametrize(
    ("exposure", "near"),
    [("spectral", 0.005), ("box", 0.005), ("mean", 0.005), ("supersample:8", 0.03)],
)
def test_motion_blurs_what_lies_across_it(exposure, near):
    """Stripes of a wave of eight pixels keep exp(-2 pi^2 sigma^2 / 64); those along it all."""
    wave = 0.5 + 0.4 * torch.cos(2 * math.pi * torch.arange(32, dtype=torch.float64) / 8)
    vertical = wave.expand(1, 3, 32, 32)
    shares = []
    for picture in (vertical, vertical.mT):
        contrast = []
        for motion in (0.0, 0.8):
            parts = {"panel": Panel(layout="even"), "lens": Lens(blur=0.3, motion_x=motion)}
            shot = Scene(sensor=Sensor(cfa="none", exposure=exposure), **parts).sample(1, (32, 32))
            contrast.append(expose(picture, shot)[..., 12:20, 12:20].std().item())
        shares.append(contrast[1] / contrast[0])
    assert shares[0] == pytest.approx(math.exp(-2 * math.pi**2 * 0.8**2 / 64), abs=near)
    assert shares[1] == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize("execution", [expose, pipeline.expose])
@pytest.mark.parametrize("sensor", [{"exposure": "spectral"}, {"reading": "binned"}])
def test_a_centre_on_the_far_edge_of_a_cell_is_one_on_the_near_edge(sensor, execution, images):
    readings = []
    for edge in (0, 1):
        layout = Layout(((0, edge, 0.5, 0.4, 0, 0, 0.4), (1, 0.5, edge, 0.4, 0, 0, 0.4)))
        scene = Scene(panel=Panel(layout=layout), sensor=Sensor(scale=2.0, **sensor))
        shot = scene.sample(len(images), images.shape[-2:], torch.Generator().manual_seed(0))
        readings.append(execution(images, shot))
    assert torch.equal(*readings)


def test_a_plan_says_where_points_do_not_show_black_matrix():
    sensor = Sensor(exposure="point")
    dark, whole = (Scene(panel=Panel(lit=share), sensor=sensor).plan() for share in (0.8, 1.0))
    assert "black matrix dims it evenly, without moiré" in str(dark)
    assert "black matrix" not in str(whole)


@pytest.mark.parametrize(
    ("elements_per_row", "rows"), [(1, 200), (2**17, 4), (2**19, 1), (2**22, 1)]
)
def test_readings_are_made_in_bands_that_fit_into_memory(elements_per_row, rows):
    shot = Scene().sample(1, (200, 4))
    light, bands = torch.zeros(1, 3, 200, 4), []

    def read(band):
        bands.append(len(band))
        return torch.zeros(1, 3, len(band), 4)

    in_bands(read, torch.arange(200), elements_per_row, light, shot)
    assert sum(bands) == 200 and rows / 2 <= max(bands) <= rows
