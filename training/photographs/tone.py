"""Tone and tint: the global colour map between two pictures, and levels of a photo."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Plane = NDArray[Any]  # of float32

PIXEL_STEP = 7  # every seventh pixel is enough for 21 coefficients
GREY_SHARE = 0.1  # share of the pixels that count as grey
RIDGE_SHARE = 1e-6  # of the mean power of a column: flat pictures have a map, too


class ColourMap(NamedTuple):
    """Per channel a polynomial of 1, r, g, b, and r^2, g^2, b^2; codes in, codes out."""

    coefficients: NDArray[Any]  # (7, 3)

    @staticmethod
    def fit(picture: Plane, target: Plane) -> ColourMap:
        """Find the map that brings a picture nearest to another, by least squares.

        Args:
            picture, target: (3, H, W), in codes of 255.
        """
        powers = _powers(picture.reshape(3, -1)[:, ::PIXEL_STEP]).astype(np.float64)
        gram = powers @ powers.T
        gram += RIDGE_SHARE * np.trace(gram) / len(gram) * np.eye(len(gram))
        right = powers @ target.reshape(3, -1)[:, ::PIXEL_STEP].T
        return ColourMap(np.linalg.solve(gram, right))

    def __call__(self, picture: Plane) -> Plane:
        """Return the picture (3, H, W) with its colours mapped, clipped to codes."""
        mapped = self.coefficients.T.astype(np.float32) @ _powers(picture.reshape(3, -1))
        return mapped.reshape(picture.shape).clip(0, 255)


def _powers(pixels: Plane) -> Plane:
    """Return 1, r, g, b, r^2, g^2, b^2 of pixels (3, N), (7, N)."""
    x = pixels / 255
    return np.concatenate([np.ones_like(x[:1]), x, x * x])


def psnr(picture: Plane, target: Plane) -> float:
    """Return the peak signal-to-noise ratio in dB; at most 100, as for equal pictures."""
    error = float(np.square(picture - target).mean(dtype=np.float64))
    return float(min(100.0, 10 * np.log10(255**2 / max(error, 1e-12))))


def levels(photo: Plane, reference: Plane) -> dict[str, float]:
    """Return white, black, contrast, saturation and cast of a photo (3, H, W), in codes.

    Args:
        reference: picture whose grey pixels are measured: the original, or else the photo itself,
            whose cast is then underestimated, as its greys are by definition those without any.
    """
    luma = photo.mean(0)
    black, white = np.percentile(luma, [1, 99])
    colourfulness = reference.max(0) - reference.min(0)
    grey = colourfulness <= np.quantile(colourfulness, GREY_SHARE)
    red, green, blue = (float(plane[grey].mean()) for plane in photo)
    return {
        "white": float(white),
        "black": float(black),
        "contrast": float(luma.std()),
        "saturation": float((photo.max(0) - photo.min(0)).mean()),
        "cast_red": red - green,
        "cast_blue": blue - green,
    }
