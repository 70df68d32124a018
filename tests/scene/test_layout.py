"""Layouts as data, what is refused, and what is derived from them."""

import json
import math
import pickle
import re

import pytest
import torch

from moireaug import Panel, Scene, Shot
from moireaug.camera.panel import emits
from moireaug.scene.layout import LAYOUTS, Layout, layout_from_dict
from moireaug.scene.subpixel import Subpixel

OWN = Layout(((0, 0.0, 0.0, 0.5, 1.0), (1, 0.5, 0.0, 1.0, 0.4), (2, 1.25, 0.5, 1.75, 1.0)), (2, 1))
RED_ONLY = Layout(((0, 0.0, 0.0, 0.5, 1.0),))
SLANTED = Layout(((0, 0.5, 0.5, 0.4, 0.2, -0.1, 0.6), (1, 0.9, 0.1, 0.3, 0.0, 0.2, 0.5)))
ALL = {**LAYOUTS, "own": OWN}
INTO_THE_NEXT_CELL = ((2, 0.1, 0.5, 0.4, 0, 0.2, 0.4), (2, 0.8, 0.5, 0.4, 0, 0, 0.4))

BAD = [
    (lambda: Layout(()), "at least one"),
    (lambda: Layout(((0, 0, 0, 1, 1),), (1,)), "numbers of panel pixels in [1, 16]; got (1,)"),
    (lambda: Layout(((0, 0, 0, 1, 1),), (1, 0)), "in [1, 16]; got (1, 0)"),
    (lambda: Layout(((0, 0, 0, 1, 1),), (1.0, 1)), "in [1, 16]; got (1.0, 1)"),
    (lambda: Layout(((0, 0, 0, 1),)), "ay, dx, dy) parallelograms, all numbers; got (0, 0, 0, 1)"),
    (lambda: Layout((("red", 0, 0, 1, 1),)), "numbers; got ('red', 0, 0, 1, 1)"),
    (lambda: Layout(((True, 0, 0, 1, 1),)), "numbers; got (True, 0, 0, 1, 1)"),
    (lambda: Layout(((3, 0, 0, 1, 1),)), "0 (red), 1 (green) or 2 (blue); got 3"),
    (lambda: Layout(((0, 0, 0, 1.5, 1),)), "inside its cell of 1 x 1 panel pixels"),
    (lambda: Layout(((0, 0.5, 0, 0.5, 1),)), "x0 < x1 and y0 < y1"),
    (lambda: Layout(((0, 0, math.nan, 1, 1),)), "x0 < x1 and y0 < y1"),
    (lambda: Layout(((1, 0, 0, 0.6, 1), (1, 0.5, 0.5, 1, 1))), "got (1, 0, 0, 0.6, 1) and"),
    (lambda: Layout(((0, 0.5, 0.5, 0.4, 0.2, 0.2, 0.1),)), "must have an area: its edges must not"),
    (lambda: Layout(((0, 1.1, 0.5, 0.4, 0, 0, 0.4),)), "centre in its cell and be no larger than"),
    (lambda: Layout(((0, 0.5, 0.5, 0.8, 0, 0.3, 0.4),)), "1.1 panel pixels wide in a cell of 1 x"),
    (lambda: Layout(((0, 0.5, 0.5, 0.1, 0.6, 0, 0.6),)), "1.2 panel pixels high in a cell of 1 x"),
    (lambda: Layout(((0, 0.5, math.nan, 0.4, 0, 0, 0.4),)), "centre in its cell and be no larger"),
    (lambda: Layout(INTO_THE_NEXT_CELL), "must not overlap"),
    (lambda: Panel(layout="pentil"), "Did you mean 'pentile'?"),
    (lambda: Panel(layout=3), "must be one of 'rgb_stripe'"),
    (lambda: Layout(5), "Layout.subpixels must be a tuple; got 5"),
    (lambda: Layout(((0, 0, 0, 1, 1),), (True, 1)), "in [1, 16]; got (True, 1)"),
    (lambda: Panel(layout={"subpixel": ()}), "Did you mean 'subpixels'?"),
]


def test_wrong_layouts_get_a_sentence():
    for make, sentence in BAD:
        with pytest.raises((ValueError, TypeError), match=re.escape(sentence)):
            make()


def test_numbers_of_an_array_and_overlapping_colours_are_taken():
    floats = Layout(((0.0, 0.0, 0.0, 0.5, 1.0),))
    assert Scene(panel=Panel(layout=floats)).plan() == Scene(panel=Panel(layout=RED_ONLY)).plan()
    assert len(Layout(((0, 0, 0, 0.6, 1), (1, 0.5, 0, 1, 1))).subpixels) == 2


def test_subpixels_know_their_place():
    (red,), (green,), (blue,) = (OWN.of(c) for c in range(3))
    assert red == Subpixel(0, (0.25, 0.5), (0.5, 0.0), (0.0, 1.0), (2, 1))
    assert green == Subpixel(1, (0.75, 0.2), (0.5, 0.0), (0.0, 0.4), (2, 1))
    assert blue.corners() == [(1.25, 0.5), (1.75, 0.5), (1.75, 1.0), (1.25, 1.0)]
    assert blue.is_rectangle and blue.area == 0.25
    assert blue.centre == (1.5, 0.75) and blue.pixel == (1.5, 0.5)
    assert [s.pixel for s in LAYOUTS["pentile"].all()] == [(0.5, 0.5), (0.5, 0.5), (1.5, 0.5)]
    assert RED_ONLY.of(1) == ()


# a layout, and the period and the number of subpixels of each colour in its smallest cell
STRIPES = tuple((c, x + c / 3, 0, x + (c + 1) / 3, 2) for x in range(3) for c in range(3))
CHECKS = ((0, 0, 0, 1, 1), (0, 1, 1, 2, 2), (1, 0, 1, 1, 2), (2, 0, 0, 0.5, 2), (2, 1, 0, 1.5, 2))
ALMOST = ((0, 0, 0, 0.5, 1), (0, 1, 0, 1.5, 1), (0, 2, 0, 2.500001, 1))
# at the end of its cell, as a parallelogram may be
ON_THE_EDGE = ((0, 2.0, 0.5, 0.4, 0.0, 0.2, 0.5), (0, 1.0, 0.5, 0.4, 0.0, 0.2, 0.5))
LONG_SLANTS = tuple((0, x, 0.5, 0.2, 0, 1.3, 1) for x in (0.5, 1.5))
REPEATED = {
    "pentile": (LAYOUTS["pentile"], [((2, 1), 1), ((1, 1), 1), ((2, 1), 1)]),
    "diamonds": (LAYOUTS["pentile_diamond"], [((2, 2), 2), ((1, 1), 1), ((2, 2), 2)]),
    "chevrons": (LAYOUTS["chevron"], [((1, 2), 2)] * 3),
    "stripes in a cell of six": (Layout(STRIPES, (3, 2)), [((1, 2), 1)] * 3),
    "checks": (Layout(CHECKS, (2, 2)), [((2, 2), 2), ((2, 2), 1), ((1, 2), 1)]),
    "almost": (Layout(ALMOST, (3, 1)), [((3, 1), 3)]),
    "on the edge": (Layout(ON_THE_EDGE, (2, 1)), [((1, 1), 1)]),
    "longer than the smaller cell": (Layout(LONG_SLANTS, (2, 1)), [((2, 1), 2)]),
}


@pytest.mark.parametrize("name", REPEATED)
def test_a_colour_takes_the_smallest_cell_that_it_repeats_with(name):
    """The panel emits the same as the subpixels that were declared."""
    layout, expected = REPEATED[name]
    for channel, (period, n) in enumerate(expected):
        assert [s.period for s in layout.of(channel)] == [period] * n
    x, y = 40 * torch.rand(2, 5000, generator=torch.Generator().manual_seed(0)).double() - 20
    share = torch.tensor(0.9).double()
    for channel in range(len(expected)):
        rows = [row for row in layout.subpixels if row[0] == channel]
        declared = [Layout((row,), layout.period) for row in rows]
        wanted = sum(emits(*one.all(), x, y, share, share) for one in declared)
        assert torch.equal(wanted, sum(emits(s, x, y, share, share) for s in layout.of(channel)))


def test_parallelograms_know_their_place():
    ((red,), (green,)) = SLANTED.of(0), SLANTED.of(1)
    assert not red.is_rectangle and red.area == pytest.approx(0.4 * 0.6 + 0.1 * 0.2)
    assert sum(green.corners(), ()) == pytest.approx(
        (0.65, -0.15, 0.95, -0.15, 1.15, 0.35, 0.85, 0.35)
    )
    assert green.pixel == (0.5, 0.5)  # of its centre, though it reaches into the next


def test_diamonds_touch_and_do_not_overlap():
    """As in a PenTile of diamonds: the bounding boxes overlap, the subpixels do not."""
    places = (0.5, 0.5), (1.0, 1.0)
    diamonds = tuple((1, x, y, 0.5, 0.5, -0.5, 0.5) for x, y in places)
    assert len(Layout(diamonds, (2, 2)).subpixels) == 2
    with pytest.raises(ValueError, match="must not overlap"):
        Layout((diamonds[0], (1, 0.9, 0.9, 0.5, 0.5, -0.5, 0.5)), (2, 2))


RASTERS = dict.fromkeys(("rgb_stripe", "bgr_stripe", "rgb_column", "pentile"), 3)
RASTERS |= {"led": 12, "wrgb": 4, "even": 1, "own": 20}


def test_a_raster_is_as_coarse_as_fits_the_rectangles():
    for name, raster in RASTERS.items():
        assert ALL[name].raster == raster
        edges = [v for s in ALL[name].subpixels for v in s[1:]]
        for n in range(1, raster + 1):
            fits = max(abs(v * n - round(v * n)) for v in edges) < 1e-6
            assert fits == (n == raster), name
    assert Layout(((0, 0.0137, 0.2, 0.777, 0.9001),)).raster == 24


@pytest.mark.parametrize("layout", [OWN, RED_ONLY, SLANTED], ids=["own", "red only", "slanted"])
def test_a_scene_with_its_own_layout_is_plain_data(layout):
    scene = Scene(panel=Panel(layout=layout, lit=(0.5, 0.9)))
    values = json.loads(json.dumps(scene.to_dict()))
    again = Scene.from_dict(values)
    assert again == scene and hash(again) == hash(scene) and again.panel.layout == layout
    assert pickle.loads(pickle.dumps(scene)) == scene
    assert Panel(layout={"subpixels": layout.subpixels, "period": layout.period}).layout == layout
    assert layout_from_dict(values["panel"]["layout"]) == layout == scene.panel.cell
    shot = scene.sample(1, (4, 4))
    assert Shot.from_dict(json.loads(json.dumps(shot.to_dict()))).to_dict() == shot.to_dict()
