"""The pose of the screen, as a homography from image to ideal photo coordinates.

Convention: continuous coordinates, pixel centres at half integers, x right, y down. *Image*
coordinates span [0, W] x [0, H] on the picture that is shown, *photo* coordinates [0, W] x [0, H]
on the photo. The homography maps image to ideal (pinhole) photo coordinates. Fields are (B,);
everything is float64 and differentiable in every field.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import ModuleType
from typing import Any

import torch
from torch import Tensor

from moireaug.common.numeric import array_like
from moireaug.common.physics.lens import radial_factor
from moireaug.scene.drawn_parts import DrawnView
from moireaug.scene.geometry.frame import FrameSize, Number, Pair

BEHIND_CAMERA = 1e9  # where points behind the camera are put
MIN_POINT_DEPTH = 1e-9  # depth above which a point counts as in front of the camera
BORDER_STEPS = (-1.0, -0.5, 0.0, 0.5, 1.0)
# points of a picture's border, in halves of its sides
BORDER = [(x, y) for x in BORDER_STEPS for y in BORDER_STEPS if max(abs(x), abs(y)) == 1]


def _matrix(rows: Sequence[Sequence[Tensor | float]], like: Tensor) -> Tensor:
    zero = torch.zeros_like(like)
    entries: list[Tensor] = []
    for row in rows:
        entries += [entry if isinstance(entry, Tensor) else zero + entry for entry in row]
    return torch.stack(entries, -1).unflatten(-1, (len(rows), len(rows[0])))


def _rotation_columns(yaw: Any, pitch: Any, roll: Any, xp: ModuleType) -> tuple[Any, ...]:
    """Return the rotated x, y and depth of a point (x, y) in the screen's plane, each as its two
    coefficients of x and y."""
    (sy, cy), (sp, cp), (sr, cr) = (
        (xp.sin(a), xp.cos(a)) for a in map(xp.deg2rad, (yaw, pitch, roll))
    )
    across = (cy * cr, cy * sr)
    down = (sp * sy * cr - cp * sr, sp * sy * sr + cp * cr)
    depth = (cp * sy * cr + sp * sr, cp * sy * sr - sp * cr)
    return *across, *down, *depth


def focal_length(fov: Any, size: tuple[int, int], xp: ModuleType = torch) -> Any:
    """Return the focal length in photo pixels, (B,), of a camera before which the diagonal of a
    whole photo of `size` spans the angle `fov`, (B,) in degrees."""
    return math.hypot(*size) / 2 / xp.tan(xp.deg2rad(fov) / 2)


def camera_pose(
    view: DrawnView, lens: Pair, size: FrameSize, focal: Any, xp: ModuleType = torch
) -> Pair:
    """Return the homography (B, 3, 3) of a pinhole camera, about the centres of image and photo,
    and how many photo pixels an image pixel in the middle of the picture takes along each axis
    before it is turned, (B,).

    view: its fields are (B,) tensors or arrays, of the module `xp`: numpy is faster for so few.
    lens: k1 and k2, (B,), so that a fitted picture stays in view after the distortion.
    size: height and width of the whole photo. focal: (B,) focal length in photo pixels.
    """
    h, w = size
    xx, xy, yx, yy, zx, zy = _rotation_columns(view.yaw, view.pitch, view.roll, xp)
    zx, zy, zoom = zx / focal, zy / focal, view.zoom
    if view.fit:
        turned = [xp.stack(pair) for pair in ((xx, xy), (yx, yy), (zx, zy))]
        zoom = zoom * _fitting_zoom(turned, lens, size, xp)
    right, down = view.shift_x * w, view.shift_y * h
    entries = [zoom * xx + right * zx, zoom * xy + right * zy, right]
    entries += [zoom * yx + down * zx, zoom * yy + down * zy, down]
    entries += [zx, zy, xp.ones_like(zx)]
    return xp.stack(entries, -1).reshape(-1, 3, 3), zoom


def released_pose(view: DrawnView, size: tuple[int, int], scale: float) -> Tensor:
    """Return the homography (B, 3, 3) of the paper's released code, M = A2 T RX RY RZ A1 in indices
    of the sensor's raster, about the centres of image and photo.

    The focal length is d / (2 sin gamma), and d where sin gamma = 0, d being the raster's diagonal;
    a negative one is kept. gamma = -roll turns clockwise, theta = -pitch and phi = yaw.
    """
    theta, phi, gamma = (torch.deg2rad(a) for a in (-view.pitch, view.yaw, -view.roll))
    h, w = size[0] * scale, size[1] * scale
    one, zero = torch.ones_like(gamma), torch.zeros_like(gamma)
    sin_gamma = torch.sin(gamma)
    frontal = sin_gamma == 0
    diagonal = (h * h + w * w) ** 0.5
    f = torch.where(frontal, one, 0.5 / torch.where(frontal, one, sin_gamma)) * diagonal

    def turn(angle: Tensor, a: int, b: int) -> Tensor:
        entries = [[one if i == j else zero for j in range(4)] for i in range(4)]
        entries[a][a] = entries[b][b] = torch.cos(angle)
        entries[a][b], entries[b][a] = -torch.sin(angle), torch.sin(angle)
        return _matrix(entries, gamma)

    a1 = _matrix([[1.0, 0.0, -w / 2], [0.0, 1.0, -h / 2], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]], gamma)
    t = _matrix([[1.0, 0, 0, 0], [0, 1.0, 0, 0], [0, 0, 1.0, f], [0, 0, 0, 1.0]], gamma)
    a2 = _matrix([[f, 0, w / 2, 0], [0, f, h / 2, 0], [0, 0, 1.0, 0]], gamma)
    m = a2 @ t @ turn(theta, 1, 2) @ turn(phi, 0, 2) @ turn(gamma, 0, 1) @ a1
    # index coordinates of the raster are scale * (x - centre) + scale * centre - 1/2 in centred
    # image coordinates
    x, y = w / 2 - 0.5, h / 2 - 0.5
    to_index = _matrix([[scale, 0, x], [0, scale, y], [0, 0, 1.0]], gamma)
    back = _matrix([[1 / scale, 0, -x / scale], [0, 1 / scale, -y / scale], [0, 0, 1.0]], gamma)
    m = back @ m @ to_index
    return m / m[:, 2:, 2:]  # depth positive in the centre, whatever the sign of the focal length


def pose_of(
    view: DrawnView, lens: Pair, size: FrameSize, focal: Any, scale: float, xp: ModuleType = torch
) -> Pair:
    """Return what `camera_pose` does, of whichever pose a view has; of the released one, every
    pixel is as large. scale: sensor pixels per photo pixel, which only that pose reads."""
    if view.pose != "released":
        return camera_pose(view, lens, size, focal, xp)
    one = xp.ones_like(view.zoom)
    if xp is torch:
        return released_pose(view, size, scale), one
    tensors = {name: torch.from_numpy(getattr(view, name)) for name in view.ranged}
    return released_pose(view.drawn(tensors), size, scale).numpy(), one


def about_corners(pose: Tensor, size: FrameSize) -> Tensor:
    """Return the homography from image to ideal photo coordinates, (B, 3, 3) float64, of one about
    the centres of both; size: height and width of the whole photo, see `frame.Frame`."""
    h, w = size
    return translation(w / 2, h / 2, pose) @ pose @ translation(-w / 2, -h / 2, pose)


def translation(x: Number, y: Number, like: Tensor) -> Tensor:
    """Return the homography that moves points by x and y, (3, 3) or (B, 3, 3) of like's dtype."""
    if not isinstance(x, Tensor):
        return like.new_tensor([[1, 0, x], [0, 1, y], [0, 0, 1]])
    return _matrix([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]], x).to(like.dtype)


def _fitting_zoom(turned: list, lens: Pair, size: FrameSize, xp: ModuleType) -> Any:
    """Return the greatest magnification at which the picture's border still lies inside the photo,
    (B,); turned: x, y and depth, (2, B) each, the coefficients of a point (x, y) of the picture in
    those of the turned picture, whose depth is 1 in its middle."""
    (h, w), (x, y, depth), (k1, k2) = size, turned, lens
    points = [(right * (w / 2), down * (h / 2)) for right, down in BORDER]
    border = array_like(points, x)
    depth = border @ depth + 1  # (16, B)
    ahead = depth > MIN_POINT_DEPTH
    depth = xp.where(ahead, depth, 1.0)
    x, y = (xp.where(ahead, border @ row / depth, BEHIND_CAMERA) for row in (x, y))
    to_edge = 1 / xp.maximum(xp.abs(x) / (w / 2), xp.abs(y) / (h / 2))  # along each point's ray
    r2 = (x * x + y * y) * to_edge * to_edge * (4 / (h * h + w * w))
    return xp.amin(to_edge * radial_factor(r2, k1, k2), 0)


def apply_homography(m: Tensor, points: Tensor) -> Tensor:
    """Map points (B, N, 2) by homographies (B, 3, 3). Points behind the camera land far away, where
    kornia's `transform_points` mirrors them to the front. What is NaN, such as a keypoint that
    nobody has seen, stays NaN."""
    lifted = points @ m[:, :, :2].mT + m[:, None, :, 2]
    behind = lifted[..., 2:] <= MIN_POINT_DEPTH
    depth = torch.where(behind, 1.0, lifted[..., 2:])
    return torch.where(behind, BEHIND_CAMERA, lifted[..., :2] / depth)
