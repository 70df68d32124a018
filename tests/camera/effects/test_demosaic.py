"""Colours of a mosaic against the published filters, site by site."""

import numpy as np
import pytest
import torch

from moireaug.camera.effects.demosaic import demosaic_bilinear, demosaic_malvar

# Malvar, He and Cutler (2004), figure 2, in eighths, as printed: (wanted colour, site) to filter
AT_OTHER = [[0, 0, -1, 0, 0], [0, 0, 2, 0, 0], [-1, 2, 4, 2, -1], [0, 0, 2, 0, 0], [0, 0, -1, 0, 0]]
SIDES = [0, -1, 0, -1, 0]
IN_ROW = [[0, 0, 0.5, 0, 0], SIDES, [-1, 4, 5, 4, -1], SIDES, [0, 0, 0.5, 0, 0]]
IN_COLUMN = np.transpose(IN_ROW)
BESIDE, CORNERS = [0, 0, -1.5, 0, 0], [0, 2, 0, 2, 0]
ACROSS = [BESIDE, CORNERS, [-1.5, 0, 6, 0, -1.5], CORNERS, BESIDE]
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
        rows, cols = range(max(y - 1, 0), min(y + 2, h)), range(max(x - 1, 0), min(x + 2, w))
        own = [mosaic[i, j] for i in rows for j in cols if (i % 2, j % 2) in sites[channel]]
        colour[channel, y, x] = np.mean(own)
    return colour


MOSAICS = torch.rand(3, 8, 10, dtype=torch.float64, generator=torch.Generator().manual_seed(5))


@pytest.mark.parametrize(
    ("demosaic", "loops", "border"),
    [(demosaic_malvar, published, 0), (demosaic_bilinear, nearest_mean, 1)],
)
def test_demosaics_are_the_published_ones(demosaic, loops, border):
    inner = (slice(border, 8 - border), slice(border, 10 - border))
    for mosaic, colour in zip(MOSAICS, demosaic(MOSAICS), strict=True):
        assert np.abs(colour.numpy() - loops(mosaic.numpy()))[:, *inner].max() < 1e-12


@pytest.mark.parametrize("swap", [(1, 1), (0, 1)], ids=["red for blue", "green for colour"])
def test_another_phase_of_the_cell_is_not_the_published_one(swap):
    shifted = torch.roll(MOSAICS, swap, (1, 2))
    colour = torch.roll(demosaic_malvar(shifted), (-swap[0], -swap[1]), (2, 3))
    assert np.abs(colour[0].numpy() - published(MOSAICS[0].numpy()))[:, 3:-3, 3:-3].max() > 0.1
