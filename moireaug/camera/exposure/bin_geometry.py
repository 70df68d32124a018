"""Where the bins of a binned reading lie, on the sensor and on the panel."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from moireaug.scene.geometry import grids
from moireaug.scene.geometry.frame import planar
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord


class Bins(NamedTuple):
    """Bins of sensor pixels, one for each photo pixel.

    Args:
        position: (B, h, w, 2) float64, where a bin's middle looks, in panel pixels, from the
            panel's corner on.
        centre: (B, h, w, 2) float64, where it lies, u and v in sensor pixels, from the sensor's
            corner on.
        step: (B, h, w, 2, 2), change of position per sensor pixel along u and v.
        sides: (B, h, w, 2, 2), u and v of a bin's two sides in sensor pixels, the last axis over
            the sides. Bins smaller than a sensor pixel are as large as one: the photo interpolates
            between sensor pixels. With the resize "point", all are the sensor's pixels.
        window: (B, h, w, 2, 2), sides in which the picture is seen: the same, or of a point resize
            about a sensor pixel, the same in all of the photo.
        triangle: (B, 1, 1), factor on the sides for a second mean over them, which makes a triangle
            filter of the first; 0 for none.
    """

    position: Tensor
    centre: Tensor
    step: Tensor
    sides: Tensor
    window: Tensor
    triangle: Tensor


def bins_at(rows: Tensor, cols: Tensor, dtype: torch.dtype, shot: ShotRecord) -> Bins:
    """Return the bins of photo pixels in rows x cols; step, sides and triangle of that dtype.

    In the camera's frame they are squares of the sensor; in the image's, of the image. Pixels of
    the image that lie outside the photo get the bin at its nearest edge.
    """
    points = grids.grid(rows, cols).expand(len(shot), -1, -1, -1)
    if shot.scene.is_rectified:
        return _bins(points, clamped_photo_points(points, shot)[0], dtype, shot)
    frame, inverse = shot.frame, shot.inverse_matrix()
    photo_points = points + frame.photo_corner(points)
    image_points = grids.photo_to_image(photo_points, inverse, frame.size, shot.distortion)
    image_points = image_points - frame.image_corner(points)
    return _bins(image_points, photo_points, dtype, shot)


def bins_on_image(points: Tensor, shot: ShotRecord) -> Bins:
    """Return the bins that see image points (B, h, w, 2)."""
    return _bins(points, clamped_photo_points(points, shot)[0], torch.float64, shot)


def middle_bins(shot: ShotRecord) -> Bins:
    """Return the bins in the middle of the whole photo, or of its picture, (B, 1, 1)."""
    frame, middle = shot.frame, middle_of_photo(shot)
    corner = frame.image_corner if shot.scene.is_rectified else frame.photo_corner
    column, row = (middle - corner(middle))[:, 0].unbind(-1)
    return bins_at(row, column, torch.float64, shot)


def image_middle_bins(shot: ShotRecord) -> Bins:
    """Return the bins in the middle of the image, (B, 1, 1)."""
    row, column = (shot.panel_scale.new_tensor([side / 2]) for side in shot.size)
    return bins_at(row, column, torch.float64, shot)


def middle_of_photo(shot: ShotRecord) -> Tensor:
    """Return the point in the middle of the whole photo, and of the picture's frame, (B, 1, 1, 2)
    float64."""
    height, width = shot.frame.size
    none = torch.zeros_like(shot.panel_scale)
    return torch.stack((none + width / 2, none + height / 2), -1)[:, None, None]


def _bins(image_points: Tensor, photo_points: Tensor, dtype: torch.dtype, shot: ShotRecord) -> Bins:
    """Return the bins that see image points, about the image's corner, from points of the whole
    photo, (B, h, w, 2) each."""
    alpha, scale = (t[:, None, None, None] for t in (shot.panel_scale, shot.sensor_scale))
    # float64: of a grazing view, float32 would leave nothing of the determinant
    inverse, size = shot.inverse_matrix(), shot.frame.size
    jacobian = grids.jacobian(photo_points, inverse, size, shot.distortion)
    step = (jacobian * (alpha / scale)[..., None]).to(dtype)
    photo_pixel = torch.eye(2, dtype=jacobian.dtype, device=jacobian.device)
    if shot.scene.is_rectified:
        photo_pixel = _inverse(jacobian)
    enlarged = enlargement(shot.bin_scale, shot.scene)
    wide = scale[..., None] * enlarged[:, None, None, None, None]
    window = sides = (photo_pixel * wide).to(dtype).expand_as(step)
    if shot.scene.develop.resize == "point":
        sides = torch.eye(2, dtype=dtype, device=step.device).expand_as(step)
    triangle = triangle_factor(enlarged, shot.scene)
    corner = shot.panel_corner[:, None, None]
    position, centre = image_points * alpha + corner, photo_points * scale
    return Bins(position, centre, step, sides, window, triangle.to(dtype)[:, None, None])


def enlargement(bin_scale: Any, scene: SceneRecord) -> Any:
    """Return the factor by which bins of `shot.bin_scale` (B,) are enlarged to the size of a sensor
    pixel; a point resize sees all of them in that size, and shrinks larger ones. Of torch or
    numpy."""
    factor = 1 / bin_scale
    return factor if scene.develop.resize == "point" else factor.clip(min=1)


def triangle_factor(enlarged: Any, scene: SceneRecord) -> Any:
    """Return the factor (B,) on bins' sides for a second mean over them, 0 for none, from their
    `enlargement`. Of torch or numpy."""
    # the photo interpolates between larger sensor pixels
    return 1 / enlarged if scene.develop.resize == "antialias" else 0 * enlarged


def clamped_photo_points(image_points: Tensor, shot: ShotRecord) -> tuple[Tensor, Tensor]:
    """Return where image points (B, h, w, 2) lie on the whole photo, float64, and which do, (B, h,
    w) bool; those that do not are put at its nearest edge. Of a photo that a picture fits, that is
    at most 0.3 % of a side away, see `View.fit`: a lens may bend a border outwards between the
    points that are fitted."""
    frame = shot.frame
    image_points = image_points + frame.image_corner(image_points)
    points = grids.image_to_photo(image_points, shot.matrix(), frame.size, shot.distortion)
    size = planar(frame.width, frame.height, points)
    on_photo = ((points >= 0) & (points <= size)).all(-1)
    return torch.minimum(torch.maximum(points, torch.zeros_like(size)), size), on_photo


def pixels_on_photo(shot: ShotRecord) -> tuple[Tensor, Tensor]:
    """Return `clamped_photo_points` of the centres of all pixels of the image."""
    centres = grids.pixel_centres(shot.size, shot.device).expand(len(shot), -1, -1, -1)
    return clamped_photo_points(centres, shot)


def _inverse(m: Tensor) -> Tensor:
    """Return the inverses of matrices (..., 2, 2)."""
    a, b, c, d = m[..., 0, 0], m[..., 0, 1], m[..., 1, 0], m[..., 1, 1]
    rows = torch.stack((d, -b), -1), torch.stack((-c, a), -1)
    return torch.stack(rows, -2) / (a * d - b * c)[..., None, None]
