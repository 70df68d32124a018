"""The base of exposures in closed form: the panel pixels around are summed, and the picture is
blurred before by the rest of a view."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from moireaug.camera.exposure import extreme_footprints
from moireaug.camera.exposure.axis_views import AxisView, variance_beyond_taps
from moireaug.common.numeric import is_transformed
from moireaug.scene.exposure_method import ExposureMethod
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord

# elements of the largest tensor, by device: rows are read in bands that keep to it
MAX_TENSOR_ELEMENTS = {"cpu": 2**19, "cuda": 2**27}


class ClosedForm(ExposureMethod):
    """An exposure in closed form, differentiable in the image and in every field of the shot.

    Args:
        taps: see `ExposureMethod`.
    """

    differentiable_in_shot = True

    def __init__(self, taps: int) -> None:
        self.taps = taps

    @abstractmethod
    def views(self, points: Tensor, shot: ShotRecord) -> tuple[list[AxisView], Tensor]:
        """Return the views at image points (B, h, w, 2), and the panel pixels per image pixel of
        the panel that they see, (B, 1, 1)."""

    def lost_variance(self, points: Tensor, shot: ShotRecord) -> Tensor:
        views, alpha = self.views(points.expand(len(shot), -1, -1, -1), shot)
        return variance_beyond_taps(views, alpha, self.taps)

    def max_lost_variance(self, scene: SceneRecord) -> float:
        return extreme_footprints.max_lost_variance(scene, self.taps)


def in_bands(
    read: Callable[[Tensor], Tensor],
    rows: Tensor,
    elements_per_row: int,
    light: Tensor,
    shot: ShotRecord,
) -> Tensor:
    """Return the readings (B, channels, h, w) of rows (h,), computed in bands to bound memory.

    Args:
        read: function of some rows that returns their readings.
        elements_per_row: elements of the largest tensor per row of an image.
        light: (B, 3, H, W) panel light of the images.
    """
    bands = 1
    if not torch.compiler.is_compiling():
        most = MAX_TENSOR_ELEMENTS.get(light.device.type, MAX_TENSOR_ELEMENTS["cuda"])
        bands = 1 + len(light) * len(rows) * elements_per_row // most
    recompute = shot.requires_grad and torch.is_grad_enabled() and not is_transformed()
    readings = []
    for band in rows.chunk(bands):
        if recompute:  # a pose's gradient would keep kilobytes per reading
            reading = checkpoint(read, band, use_reentrant=False, preserve_rng_state=False)
            readings.append(reading)
        else:
            readings.append(read(band))
    return torch.cat(readings, 2)
