"""The mosaic: packed and unpacked, and its colours against the published filters, site by site."""

import numpy as np
import pytest
import torch

from moireaug.effects import bayer

# Malvar, He and Cutler (2004), figure 2, in eighths, as printed: (wanted colour, site) to filter
AT_OTHER = [[0, 0, -1, 0, 0], [0, 0, 2, 0, 0], [-1, 2, 4, 2, -1], [0, 0, 2, 0, 0], [0, 0, -1, 0, 0]]
IN_ROW = [[0, 0, 0.5, 0, 0], [0, -1, 0, -1, 0], [-1, 4, 5, 4, -1], [0, -1, 0, -1, 0], [0, 0, 0.5, 0, 0]]
IN_COLUMN = [[0, 0, -1, 0, 0], [0, -1, 4, -1, 0], [0.5, 0, 5, 0, 0.5], [0, -1, 4, -1, 0], [0, 0, -1, 0, 0]]
ACROSS = [[0, 0, -1.5, 0, 0], [0, 2, 0, 2, 0], [-1.5, 0, 6, 0, -1.5], [0, 2, 0, 2, 0], [0, 0, -1.5, 0, 0]]
OWN = [[0] * 5, [0] * 5, [0, 0, 8, 0, 0], [0] * 5, [0] * 5]
MALVAR = {  # for each site of the cell, the filters of red, green and blue
    (0, 0): (OWN, AT_OTHER, ACROSS),
    (0, 1): (IN_ROW, OWN, IN_COLUMN),  # green in red's row
    (1, 0): (IN_COLUMN, OWN, IN_ROW),
    (1, 1): (ACROSS, AT_OTHER, OWN),
}


def published(mosaic):
    """One colour and one pixel at a time, zero padded."""
    h, w = mosaic.shape
    wide, colour = np.pad(mosaic, 2), np.zeros((3, h, w))
    for y, x in np.ndindex(h, w):
        for channel, taps in enumerate(MALVAR[y % 2, x % 2]):
            colour[channel, y, x] = (np.array(taps) / 8 * wide[y : y + 5, x : x + 5]).sum()
    return colour


def nearest_mean(mosaic):
    """The mean of a colour's own pixels among the nine around, away from the border."""
    h, w = mosaic.shape
    colour = np.zeros((3, h, w))
    sites = {0: [(0, 0)], 1: [(0, 1), (1, 0)], 2: [(1, 1)]}
    for channel, y, x in np.ndindex(3, h, w):
        if (y % 2, x % 2) in sites[channel]:
            colour[channel, y, x] = mosaic[y, x]
            continue
        around = [(y + i, x + j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        own = [mosaic[p] for p in around if (p[0] % 2, p[1] % 2) in sites[channel] and 0 <= p[0] < h and 0 <= p[1] < w]
        colour[channel, y, x] = np.mean(own)
    return colour


MOSAICS = torch.rand(3, 8, 10, dtype=torch.float64, generator=torch.Generator().manual_seed(5))


@pytest.mark.parametrize(
    ("demosaic", "loops", "border"), [(bayer.demosaic_malvar, published, 0), (bayer.demosaic_bilinear, nearest_mean, 1)]
)
def test_demosaics_are_the_published_ones(demosaic, loops, border):
    inner = (slice(border, 8 - border), slice(border, 10 - border))
    for mosaic, colour in zip(MOSAICS, demosaic(MOSAICS), strict=True):
        assert np.abs(colour.numpy() - loops(mosaic.numpy()))[:, *inner].max() < 1e-12


@pytest.mark.parametrize("swap", [(1, 1), (0, 1)], ids=["red for blue", "green for colour"])
def test_another_phase_of_the_cell_is_not_the_published_one(swap):
    shifted = torch.roll(MOSAICS, swap, (1, 2))
    colour = torch.roll(bayer.demosaic_malvar(shifted), (-swap[0], -swap[1]), (2, 3))
    assert np.abs(colour[0].numpy() - published(MOSAICS[0].numpy()))[:, 3:-3, 3:-3].max() > 0.1


def test_planes_are_red_green_green_blue():
    mosaic = torch.arange(24.0).reshape(1, 4, 6)
    raw = bayer.pack(mosaic)
    assert raw[0, :, 0, 0].tolist() == [0, 1, 6, 7] and raw[0, :, 1, 2].tolist() == [16, 17, 22, 23]
    assert torch.equal(bayer.unpack(raw), mosaic)
    assert torch.equal(bayer.pack(bayer.unpack(raw)), raw)


READOUTS = [  # size, scale, resize, reach, sensor pixels read, per photo pixel, ahead
    (3, 1.0, "area", 1, [0, 1, 2, 3], 1, 0),
    (2, 3.0, "area", 1, [0, 1, 2, 3, 4, 5], 3, 0),
    (2, 9.0, "point", 1, [2, 3, 4, 5, 12, 13, 14, 15], 3, 1),
    (2, 9.0, "point", 2, [2, 3, 4, 5, 6, 11, 12, 13, 14, 15], 5, 0),
    (2, 8.0, "point", 1, [2, 3, 4, 5, 10, 11, 12, 13], 4, 0),
    (2, 8.0, "point", 0, [3, 4, 11, 12], 2, 0),
    (2, 9.0, "point", 0, [4, 13], 1, 0),
    (4, 1.5, "area", 1, [0, 1, 2, 3, 4, 5], 0, 0),
    (3, 2.0, "antialias", 1, [0, 1, 2, 3, 4, 5], 0, 0),
    (3, 1.0, "antialias", 0, [0, 1, 2], 1, 0),
]


@pytest.mark.parametrize(("size", "scale", "resize", "reach", "index", "step", "lead"), READOUTS)
def test_what_is_read_of_an_axis(size, scale, resize, reach, index, step, lead):
    readout = bayer.readout(size, scale, resize, reach)
    assert (list(readout.index), readout.step, readout.lead) == (index, step, lead)
    if reach:
        assert [i % 2 for i in readout.index] == [0, 1] * (len(index) // 2)  # each of the parity of its place
