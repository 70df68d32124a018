"""Raw readings, packed as in `geometry.sensor`."""

from __future__ import annotations

from torch import Tensor

from moireaug.geometry.sensor import pack


def over_sensor(raw: Tensor, factor: Tensor, shot) -> Tensor:
    """Return readings times a factor (B, h or 1, w or 1) that differs over the sensor."""
    rows, cols = (len(pixels.index) for pixels in shot.sampled_pixels())
    factor = factor.to(raw.dtype).expand(-1, rows, cols)
    if shot.scene.cells != "rggb":
        return raw * factor[:, None]
    return raw * pack(factor)
