"""Sampling grids: where the points of a photo look on the screen, the Jacobian there, and where
points and masks of the image lie in the photo."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from moireaug.common import tensor_physics
from moireaug.common.numeric import may_be_dual
from moireaug.common.physics.lens import MIN_RAY_DEPTH
from moireaug.scene.geometry.distortion import inverse_radial_factor, radial_factor
from moireaug.scene.geometry.frame import Frame, FrameSize, per_pixel, planar
from moireaug.scene.geometry.homography import apply_homography, translation

# image pixels per photo pixel, far more than any picture has, whose squares float32 can hold on the
# finest panel; only rays at the horizon of tiny, grazing screens see more
MAX_STEP = 1e9
RadialCoefficients = tuple[Tensor, Tensor]  # k1 and k2, (B,) each


def grid(rows: Tensor, cols: Tensor) -> Tensor:
    """Return the points, x then y, of rows (h,) and columns (w,), or (B, h) and (B, w): (B or 1, h,
    w, 2)."""
    points = _planar(*torch.broadcast_tensors(cols[..., None, :], rows[..., :, None]))
    return points if points.ndim == 4 else points[None]


def pixel_centres(size: tuple[int, int], device: torch.device) -> Tensor:
    """Return the centres of all pixels of an image, (1, H, W, 2) float64."""
    rows, cols = (torch.arange(n, dtype=torch.float64, device=device) + 0.5 for n in size)
    return grid(rows, cols)


def look_up(picture: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Sample a picture (B, C, H, W) at coordinates x, y (B, h, w): (B, C, h, w). Bilinear between
    pixel centres, which lie at half integers; the edge pixels are repeated past the edges.
    Differentiable in picture and coordinates."""
    h, w = picture.shape[-2:]
    if any(may_be_dual(t) for t in (picture, x, y)):
        return _gathered(picture, x, y)
    at = torch.stack((x * (2 / w) - 1, y * (2 / h) - 1), -1).to(picture.dtype)
    return F.grid_sample(picture, at, padding_mode="border", align_corners=False)


def _gathered(picture: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Do the same as `look_up`, by steps with forward derivatives, which grid_sample lacks."""
    h, w = picture.shape[-2:]
    x, y = (x - 0.5).clamp(0, w - 1), (y - 0.5).clamp(0, h - 1)
    left, top = x.detach().floor(), y.detach().floor()
    right, below = (left + 1).clamp(max=w - 1), (top + 1).clamp(max=h - 1)
    across, down = ((at - first).to(picture.dtype)[:, None] for at, first in ((x, left), (y, top)))

    def pixels(row: Tensor, column: Tensor) -> Tensor:
        place = (row * w + column).long()[:, None].flatten(2).expand(-1, picture.shape[1], -1)
        return picture.flatten(2).gather(2, place).unflatten(2, row.shape[1:])

    upper, lower = (
        pixels(row, left) * (1 - across) + pixels(row, right) * across for row in (top, below)
    )
    return upper * (1 - down) + lower * down


def photo_to_image(
    points: Tensor, inverse: Tensor, size: FrameSize, lens: RadialCoefficients | None
) -> Tensor:
    """Return where photo points (B or 1, h, w, 2) look on the screen, in image coordinates (B, h,
    w, 2); far outside the picture at and past the horizon. Differentiable.

    inverse: (B, 3, 3), from ideal photo to image coordinates, scaled to depth 1 where the photo
        shows the image's centre.
    size: height and width of the whole photo. lens: radial distortion, or None.
    """
    ideal = points - _centre(points, size)
    if lens is not None:
        k1, k2 = lens
        ideal = ideal.expand(len(k1), -1, -1, -1)
        factor = radial_factor(ideal.flatten(1, 2), k1, k2, size)
        ideal = ideal * factor.reshape(ideal.shape[:3])[..., None]
    u, v = ideal.unbind(-1)
    x, y, depth = (a * u + b * v + c for a, b, c in _entries(inverse, size))
    depth = depth.clamp(min=MIN_RAY_DEPTH)
    return _planar(x / depth, y / depth)


def jacobian(
    points: Tensor, inverse: Tensor, size: FrameSize, lens: RadialCoefficients | None
) -> Tensor:
    """Return d(image x, y) / d(photo u, v) at photo points (B or 1, h, w, 2): (B, h, w, 2, 2), the
    last axis over u and v. Where an entry exceeds `MAX_STEP`, all four are scaled down to it,
    without a gradient."""
    p = points - _centre(points, size)
    k1, k2 = (k[:, None, None].to(p.dtype) for k in lens) if lens is not None else (0.0, 0.0)
    radius_scale = per_pixel(4 / (size[0] ** 2 + size[1] ** 2), p.dtype)
    u, v = p.unbind(-1)
    entries = [entry for row in _entries(inverse, size) for entry in row]
    xu, xv, yu, yv = tensor_physics.lens.image_jacobian(u, v, (radius_scale, k1, k2), entries)
    steps = torch.stack((_planar(xu, xv), _planar(yu, yv))).movedim(0, -2)
    largest = steps.detach().abs().amax((-2, -1), keepdim=True)
    bounded = steps.detach() * (MAX_STEP / largest)
    return torch.where(largest > MAX_STEP, bounded, steps)


def image_to_photo(
    points: Tensor, matrix: Tensor, size: FrameSize, lens: RadialCoefficients | None
) -> Tensor:
    """Return where image points (B, ..., 2) lie in the photo, through homography (B, 3, 3) and
    lens. Differentiable."""
    photo = apply_homography(matrix, points.flatten(1, -2))
    if lens is not None:
        centre = _centre(photo, size)
        ideal = photo - centre
        photo = ideal * inverse_radial_factor(ideal, *lens, size)[..., None] + centre
    return photo.reshape(points.shape)


def points_in_photo(
    points: Tensor, matrix: Tensor, frame: Frame, distortion: RadialCoefficients | None
) -> Tensor:
    """Return where points (B, N, 2) of the image lie in the photo, x then y in pixels, float64, by
    the matrix, frame and distortion of a shot."""
    image_points = points + frame.image_corner(points)
    moved = image_to_photo(image_points, matrix, frame.size, distortion)
    return moved - frame.photo_corner(moved)


def mask_in_photo(
    mask: Tensor, matrix: Tensor, frame: Frame, distortion: RadialCoefficients | None
) -> Tensor:
    """Return a mask (B, C, H, W) of the image as in the photo: nearest pixel, 0 off the image;
    the rest as in `points_in_photo`."""
    h, w = mask.shape[-2:]
    centres = pixel_centres((h, w), mask.device)
    photo_points = centres + frame.photo_corner(centres)
    inverse = torch.linalg.inv(matrix)
    image_points = photo_to_image(photo_points, inverse, frame.size, distortion)
    x, y = (image_points - frame.image_corner(image_points)).unbind(-1)
    on = (x >= 0) & (x < w) & (y >= 0) & (y < h)
    flat = torch.where(on, y.floor() * w + x.floor(), 0).long()[:, None].flatten(2)
    taken = mask.flatten(2).gather(2, flat.expand(-1, mask.shape[1], -1)).reshape(mask.shape)
    return torch.where(on[:, None], taken, torch.zeros_like(taken))


def _centre(like: Tensor, size: FrameSize) -> Tensor:
    return planar(size[1] / 2, size[0] / 2, like)


def _entries(inverse: Tensor, size: FrameSize) -> list[list[Tensor]]:
    """Return the entries, (B, 1, 1) each, of the homography (B, 3, 3) from ideal points, measured
    from the centre."""
    m = (inverse @ translation(size[1] / 2, size[0] / 2, inverse))[:, None, None]
    return [[m[..., i, j] for j in range(3)] for i in range(3)]


def _planar(first: Tensor, second: Tensor) -> Tensor:
    """Stack along a new last axis; each of the two stays contiguous in memory."""
    return torch.stack((first, second)).movedim(0, -1)
