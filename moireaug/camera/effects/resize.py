"""Sensor pixels to photo pixels, on codes, as apps and data pipelines do it; and registration: the
photo in the frame of the image that was shown."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from moireaug.camera.effects.base import Effect, Verdict, called, left_out
from moireaug.camera.exposure.bin_geometry import pixels_on_photo
from moireaug.common.numeric import clip_straight_through
from moireaug.scene.fields import bounds, varies
from moireaug.scene.geometry.grids import look_up
from moireaug.scene.geometry.lattice import SampledPixels
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord


class Resize(Effect):
    """Resizes the photo to the size of the image."""

    name = "resize"

    def verdict(self, scene: SceneRecord) -> Verdict:
        if scene.is_binned:
            return left_out("a binned reading has the photo's pixels")
        scale = scene.sensor.scale
        if scale == 1:
            return left_out("one sensor pixel per photo pixel")
        return called(f"{scene.develop.resize}, {scale:g} sensor pixels per photo pixel")

    def __call__(self, photo: Tensor, shot: ShotRecord) -> Tensor:
        rows, cols = shot.sampled_pixels()
        return clip_straight_through(resize(photo, rows, cols, shot.scene.develop.resize))


def resize(photo: Tensor, rows: SampledPixels, cols: SampledPixels, how: str) -> Tensor:
    """Return the pixels that were read (B, 3, h, w) as photo pixels (B, 3, H, W)."""
    step = rows.step
    if step == 1:
        return photo
    if step and how == "point":
        return window_centres(photo, step)
    if step:
        return F.avg_pool2d(photo, step)
    size = rows.size, cols.size
    if how == "area":
        return area_means(area_means(photo, rows.size).mT, cols.size).mT
    antialias = how == "antialias"
    if antialias and cols.size == 1:  # torch's antialiased single column is another picture
        return bilinear(photo.mT, size[::-1], antialias=True).mT
    return bilinear(photo, size, antialias=antialias)


def area_weights(n: int, m: int) -> tuple[list[int], list[list[float]]]:
    """Return the first of n sensor pixels that each of m photo pixels overlaps, and the shares of
    the overlap with that and the next ones, as many for each: exact where m does not divide n,
    unlike the windows of whole pixels that `F.interpolate(mode="area")` takes."""
    start, most, shares = [i * n // m for i in range(m)], 1, []
    for i, first in enumerate(start):
        most = max(most, -((i + 1) * n // -m) - first)
    for i, first in enumerate(start):
        # in m-ths of a sensor pixel
        overlaps = []
        for pixel in range(first, first + most):
            end, begin = min((pixel + 1) * m, (i + 1) * n), max(pixel * m, i * n)
            overlaps.append(max(end - begin, 0) / n)
        shares.append(overlaps)
    return start, shares


area_weights._dynamo_marked_constant = True  # type: ignore[attr-defined]  # of two whole numbers


def area_means(photo: Tensor, size: int) -> Tensor:
    """Return photos (B, 3, h, w) resized to `size` rows by the area that pixels share."""
    last, out = photo.shape[-2] - 1, photo.new_zeros(*photo.shape[:2], size, photo.shape[-1])
    start, shares = area_weights(photo.shape[-2], size)
    rows = torch.tensor(start, device=photo.device)
    weights = photo.new_tensor(shares)
    for k in range(weights.shape[1]):
        out = out + weights[:, k, None] * photo.index_select(-2, (rows + k).clamp(max=last))
    return out


def bilinear(photo: Tensor, size: tuple[int, int], *, antialias: bool) -> Tensor:
    """Return a photo (B, 3, h, w) interpolated to another size (H, W)."""
    return F.interpolate(
        photo, size=size, mode="bilinear", align_corners=False, antialias=antialias
    )


def window_centres(photo: Tensor, step: int) -> Tensor:
    """Return the mean of the 1 x 1 (odd step) or 2 x 2 (even step) pixels in the centre of each
    window."""
    across = 1 if step % 2 else 2
    first = (step - across) // 2
    windows = photo.unfold(2, step, step).unfold(3, step, step)
    return windows[..., first : first + across, first : first + across].mean((-1, -2))


class Register(Effect):
    """Warps the photo back to the image's frame, so that labels, boxes and masks stay valid. Binned
    readings lie there already; parts of the image that the photo does not show are blackened."""

    name = "register"

    def verdict(self, scene: SceneRecord) -> Verdict:
        if not scene.develop.registered:
            return left_out("the photo stays in the camera's frame")
        if not (scene.is_posed or scene.is_bent):
            return left_out("the photo is in the image's frame already")
        if scene.is_crop:
            return left_out("a crop lies within its photo; bins are read in the image's frame")
        if not scene.is_rectified:
            return called("back to the image's frame")
        if _is_shown_whole(scene):
            return left_out("bins are read in the image's frame")
        return called("black where the photo does not show the image; bins are read in its frame")

    def __call__(self, photo: Tensor, shot: ShotRecord) -> Tensor:
        points, on_photo = pixels_on_photo(shot)
        if not shot.scene.is_rectified:
            photo = clip_straight_through(look_up(photo, *points.unbind(-1)))
        return photo * on_photo.to(photo.dtype)[:, None]


def _is_shown_whole(scene: SceneRecord) -> bool:
    """Whether the photo always shows all of the image: one that fits, is not enlarged and not
    moved."""
    view = scene.view
    shifted = varies(view.shift_x) or varies(view.shift_y)
    return view.fit and bounds(view.zoom)[1] <= 1 and not shifted
