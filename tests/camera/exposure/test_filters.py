"""Colour filters whose bands overlap: what they pass, and what of it a colour matrix undoes."""

import dataclasses

import pytest
import torch

from moireaug import Develop, Lens, Panel, Scene, Sensor, View, capture, develop, expose
from moireaug.camera.exposure.filters import crosstalk_matrix
from moireaug.scene.by_name import with_values

SHARES = torch.tensor([0.0, 0.1, 0.3], dtype=torch.float64)
FULL = Sensor(cfa="none", scale=2.0, crosstalk=0.25)


def test_each_filter_shares_its_light_with_its_neighbours_in_the_spectrum():
    matrix = crosstalk_matrix(SHARES)
    assert torch.allclose(matrix.sum(2), torch.ones(3, 3).double())  # grey stays grey
    assert torch.equal(matrix[0], torch.eye(3).double())
    assert (matrix[:, 0, 2] == 0).all() and (matrix[:, 2, 0] == 0).all()
    assert matrix[2].flatten().tolist() == pytest.approx(
        [0.7, 0.3, 0.0, 0.15, 0.7, 0.15, 0.0, 0.3, 0.7]
    )


def without(scene):
    return with_values(scene, {"sensor.crosstalk": 0.0})


@pytest.mark.parametrize("exposure", ["spectral", "box", "mean", "point", "supersample:2"])
def test_each_plane_reads_what_its_filter_passes(exposure, images):
    """With three filters at every pixel, the reading is the matrix times that without crosstalk."""
    sensor = dataclasses.replace(FULL, exposure=exposure)
    scene = Scene(panel=Panel(scale=1.2), view=View(roll=5.0), sensor=sensor)
    shot, picture = scene.sample(4, (24, 32)), images.double()
    alone = expose(picture, dataclasses.replace(shot, scene=without(scene)))
    mixed = torch.einsum("ij,bjhw->bihw", crosstalk_matrix(SHARES.new_tensor([0.25]))[0], alone)
    assert torch.allclose(expose(picture, shot), mixed, atol=1e-12)


@pytest.mark.parametrize("exposure", ["spectral", "point", "supersample:2"])
def test_a_bayer_site_reads_one_filter_of_three(exposure, images):
    """The lattice of the full sensor's planes, as far as it reaches the same pixels."""
    sensor = dataclasses.replace(FULL, exposure=exposure)
    full = Scene(panel=Panel(scale=1.2), view=View(roll=5.0), sensor=sensor)
    bayer = with_values(full, {"sensor.cfa": "rggb"})
    planes, packed = (
        expose(images.double(), scene.sample(4, (24, 32), torch.Generator().manual_seed(0)))
        for scene in (full, bayer)
    )
    for plane, (channel, row, column) in enumerate([(0, 0, 0), (1, 0, 1), (1, 1, 0), (2, 1, 1)]):
        wanted = planes[:, channel, row::2, column::2]
        assert torch.allclose(packed[:, plane], wanted, atol=1e-9)


@pytest.mark.parametrize("linear_light", [False, True])
def test_a_camera_of_three_filters_a_pixel_undoes_its_crosstalk(linear_light, images):
    """The matrix is the exact inverse where every colour is read at the same place."""
    parts = {"lens": Lens(blur=0.3), "develop": Develop(linear_light=linear_light)}
    scene = Scene(panel=Panel(scale=0.9), view=View(yaw=10.0), sensor=FULL, **parts)
    shot, picture = scene.sample(4, (24, 32)), images.double()
    photo = capture(picture, shot)
    alone = capture(picture, dataclasses.replace(shot, scene=without(scene)))
    assert torch.allclose(photo, alone, atol=1e-11)
    # negative control: with a Bayer mosaic each colour aliases by itself
    bayer = with_values(scene, {"sensor.cfa": "rggb"})
    shot = bayer.sample(4, (24, 32))
    mixed, alone = (
        capture(picture, dataclasses.replace(shot, scene=s)) for s in (bayer, without(bayer))
    )
    assert (mixed - alone).abs().mean() > 0.01


def grey_screen(scale, crosstalk):
    """The reading and the photo of a grey screen of RGB stripes, without their borders."""
    parts = {"lens": Lens(blur=0.3), "develop": Develop(registered=False)}
    sensor = Sensor(scale=2.0, crosstalk=crosstalk)
    scene = Scene(panel=Panel(scale=scale), view=View(roll=3.0), sensor=sensor, **parts)
    shot = scene.sample(1, (32, 48))
    raw = expose(torch.full((1, 3, 32, 48), 0.8, dtype=torch.float64), shot)
    return raw[0, ..., 6:-6, 6:-6], develop(raw, shot)[0, ..., 6:-6, 6:-6]


def colour(photo):
    """How far from grey a photo is, root mean square."""
    return float((photo - photo.mean(0)).square().mean().sqrt())


@pytest.mark.parametrize("share", [0.1, 0.3])
@pytest.mark.parametrize("scale", [0.9, 1.1])
def test_filters_that_overlap_read_less_moire_of_stripes(scale, share):
    """The moiré of red, green and blue stripes lies thirds of a wave apart. Of one wave each, red
    and blue filters keep |1 - c + c exp(2 pi i / 3)|, green keeps 1 - 3 c / 2."""
    (alone, _), (mixed, _) = grey_screen(scale, 0.0), grey_screen(scale, share)
    kept = (mixed.std((1, 2)) / alone.std((1, 2))).tolist()
    side = ((1 - share) ** 2 + share**2 - share * (1 - share)) ** 0.5
    assert kept == pytest.approx([side, 1 - 1.5 * share, 1 - 1.5 * share, side], rel=0.02)


def test_filters_that_overlap_alias_less_in_colour_where_stripes_are_seen():
    """Panel pixels three to four sensor pixels wide: the colour matrix, which undoes crosstalk on
    flat colours, gives back only part of it between sites of a mosaic."""
    for scale in (0.5, 0.6):
        none, some, much = (colour(grey_screen(scale, share)[1]) for share in (0.0, 0.15, 0.3))
        assert much < 0.75 * none and much < some < none
    # negative control: it is no blur, and brings back the moiré of finer stripes
    none, much = (colour(grey_screen(1.3, share)[1]) for share in (0.0, 0.3))
    assert much > 1.1 * none
