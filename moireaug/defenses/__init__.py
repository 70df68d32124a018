"""Defences: transformations of the image before the model, differentiable for attacks that know
them.

Each is a frozen dataclass, called on images (B, 3, H, W) in [0, 1], that says whether it is
`randomised`. `defenses.demoire` has demoiréing networks, and the defence made of one.
"""

# ruff: noqa: E402  # a missing extra is named before it is imported

from collections.abc import Callable
from functools import partial

from moireaug.common.extras import require

require("eval", "moireaug.defenses")

from moireaug.defenses import demoire
from moireaug.defenses.base import Defence
from moireaug.defenses.defended import Compose, Defended
from moireaug.defenses.deflection import PixelDeflection
from moireaug.defenses.filters import JPEG, BitDepth, Gain, Median, restore_mean
from moireaug.defenses.quilting import Quilting
from moireaug.defenses.rejecting import Rejecting
from moireaug.defenses.variation import TotalVariation

# the paper's, by name; `Quilting` needs a bank of patches first
DEFENSES: dict[str, Callable[[], Defence]] = {
    "jpeg_20": partial(JPEG, 20),
    "jpeg_40": partial(JPEG, 40),
    "jpeg_60": partial(JPEG, 60),
    "jpeg_80": partial(JPEG, 80),
    "pixel_deflection": PixelDeflection,
    "bits_4": partial(BitDepth, 4),
    "bits_5": partial(BitDepth, 5),
    "median_2": partial(Median, 2),
    "median_3": partial(Median, 3),
    "tvm": TotalVariation,
    "gain": Gain,
}

__all__ = [
    "DEFENSES",
    "JPEG",
    "BitDepth",
    "Compose",
    "Defence",
    "Defended",
    "Gain",
    "Median",
    "PixelDeflection",
    "Quilting",
    "Rejecting",
    "TotalVariation",
    "demoire",
    "restore_mean",
]
