"""The released weights of a demoiréing network: small, found by name, and better than none."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from moireaug import Scene, capture
from moireaug.defenses import demoire
from moireaug.defenses.demoire import files
from moireaug.evaluation.visibility import psnr
from moireaug.synthesis import without_moire


def test_released_weights_clean_simulated_photos():
    """By 4.6 dB; a shuffled layer leaves less than 4, but for those that change little."""
    network = demoire.build("amnet", width=0.25, weights="screen").eval()
    whole = Scene.preset("screen_photo")
    scene = replace(whole, panel=replace(whole.panel, width=(50.0, 200.0)))
    shots = scene.sample(4, (128, 128), torch.Generator().manual_seed(0))
    shades = torch.rand(4, 3, 3, 3, generator=torch.Generator().manual_seed(0))
    pictures = torch.nn.functional.interpolate(shades, (128, 128), mode="bicubic").clamp(0, 1)
    with torch.inference_mode():
        photos = capture(pictures, shots)
        twins = capture(pictures, without_moire(shots, noise=False))
        gains = psnr(network(photos), twins) - psnr(photos, twins)
    assert gains.mean() > 4


def test_released_weights_are_small_and_named_in_errors(tmp_path):
    network = demoire.load(Path("screen"))  # as commands pass it
    assert (network.name, network.width, network.training) == ("amnet", 0.25, False)
    assert all(weights.dtype == torch.float32 for weights in network.parameters())
    for name in files.RELEASED_WEIGHTS:
        assert files.Path(files.__file__).with_name(f"{name}.pt").stat().st_size < 2e6
    with pytest.raises(ValueError, match="Pass 'screen', or a file"):
        demoire.load(tmp_path / "screan")
