"""Raw readings, packed as in `geometry.lattice`, and where they lie on the photo."""

from __future__ import annotations

from torch import Tensor

from moireaug.camera.exposure.bin_geometry import pixels_on_photo
from moireaug.scene.geometry.frame import FrameSize, per_pixel
from moireaug.scene.geometry.lattice import pack
from moireaug.scene.shot import ShotRecord


def photo_coordinates(shot: ShotRecord) -> tuple[Tensor, Tensor]:
    """Return the coordinates u and v of the sensor's pixels on the whole photo, (1, w) and (h, 1),
    or of parts of photos (B, 1, w) and (B, h, 1); of a binned reading in the image's frame, (B, h,
    w) each."""
    if shot.scene.is_rectified:
        u, v = pixels_on_photo(shot)[0].unbind(-1)
        return u, v
    rows, cols = (pixels.positions(shot.device) for pixels in shot.sampled_pixels())
    frame = shot.frame
    return cols + per_pixel(frame.photo_left), rows[:, None] + per_pixel(frame.photo_top)


def photo_size(shot: ShotRecord) -> FrameSize:
    """Return height and width of the whole photo, as numbers or (B, 1, 1)."""
    height, width = shot.frame.size
    return per_pixel(height), per_pixel(width)


def in_planes(values: Tensor, raw: Tensor, shot: ShotRecord) -> Tensor:
    """Return values (B, h or 1, w or 1) that differ over the sensor, for the planes of a raw
    reading: (B, 4 or 1, ...), of its dtype."""
    rows, cols = (len(pixels.index) for pixels in shot.sampled_pixels())
    values = values.to(raw.dtype).expand(-1, rows, cols)
    return pack(values) if shot.scene.filter_cell == "rggb" else values[:, None]
