"""The weights of resizing and demosaicing are PyTorch's, and keep grey."""

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from moireaug.effects.demosaic import DEMOSAICS
from moireaug.effects.resize import area_means
from moireaug.engine.lower.resampling import demosaic_weights, lower_resize


@pytest.mark.parametrize("how", ["area", "antialias", "point"])
@pytest.mark.parametrize(
    ("n", "m"), [(10, 10), (20, 10), (25, 10), (7, 10), (3, 1), (1, 3), (101, 37)]
)
def test_resize_is_torchs(n, m, how):
    resize = lower_resize(n, m, n, how)
    line = torch.randn(n, dtype=torch.float64)
    got = [
        float((resize.taps[i] * line[s : s + resize.taps.shape[1]].numpy()).sum())
        for i, s in _whole(resize, n)
    ]
    if how == "area":
        expected = area_means(line[None, None, :, None], m)[0, 0, :, 0]
        if n % m == 0:  # elsewhere torch's windows are of whole pixels, and uneven
            assert torch.allclose(
                expected, F.interpolate(line[None, None], size=m, mode="area")[0, 0]
            )
    else:
        lifted = line[None, None, None].expand(1, 1, 2, n)
        bilinear = {"mode": "bilinear", "align_corners": False, "antialias": how == "antialias"}
        expected = F.interpolate(lifted, size=(2, m), **bilinear)[0, 0, 0]
    known = [i for i, _ in _whole(resize, n)]
    np.testing.assert_allclose(got, expected.numpy()[known], rtol=0, atol=1e-6)


def _whole(resize, n):
    """The photo pixels all of whose taps, used or not, lie on the sensor."""
    return [(i, int(s)) for i, s in enumerate(resize.start) if s + resize.taps.shape[1] <= n]


@pytest.mark.parametrize("demosaic", DEMOSAICS)
def test_demosaics_keep_grey(demosaic):
    total = demosaic_weights(DEMOSAICS[demosaic]).sum((2, 3, 4))
    np.testing.assert_allclose(total, np.ones((4, 3)), rtol=0, atol=1e-6)
