"""What the engine and the reference read of the same shot, and how equal that must be."""

import torch

from moireaug import expose
from moireaug.camera import pipeline
from moireaug.camera.exposure.bin_geometry import pixels_on_photo
from moireaug.engine import execution

RMS, MOST = 1e-4, 1 / 512


def readings(scene, size, n=2):
    """What the engine and the reference read of the same shot."""
    shot = scene.sample(n, size, torch.Generator().manual_seed(3))
    images = torch.rand(n, 3, *size, generator=torch.Generator().manual_seed(4))
    assert not execution.call_of(shot, None, images).execution.why_not_expose
    both = expose(images, shot).double(), pipeline.expose(images.double(), shot)
    if not scene.is_rectified:
        return both
    shown = pixels_on_photo(shot)[1][:, None]  # beside the photo, beats are less exact
    return both[0] * shown, both[1] * shown


def assert_equal(got, expected):
    difference = got - expected
    assert difference.square().mean().sqrt() < RMS
    assert difference.abs().max() < MOST
