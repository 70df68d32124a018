"""Where screens lie in photos of rooms, and how far from them photo pixels look."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from moireaug.scene.geometry import grids
from moireaug.scenes import Shot

SPACING = 8  # photo pixels between those whose view of the screen is computed


def boxes_of(shape: tuple[int, int], size: tuple[int, int], drawn: dict[str, Tensor]) -> Tensor:
    """Return where the screens lie in their plane: left, top, width and height, in whole pixels of
    the photo before it is turned, (B, 4) int64. shape, size: (height, width) of pictures, photos.
    """
    fitting = min(size[0] / shape[0], size[1] / shape[1])
    picture, photo = (torch.tensor(sides[::-1], device="cpu") for sides in (shape, size))
    sides = (drawn["extent"][:, None] * fitting * picture).round().clamp(min=1)
    upper_left = torch.stack((drawn["place_x"], drawn["place_y"]), 1) * (photo - sides)
    return torch.cat((upper_left.round(), sides), 1).long()


def on_plane(picture: Tensor, box: list[int], size: tuple[int, int]) -> Tensor:
    """Return a picture (3, h, w) at its place in the screen's plane, (3, H, W), its edges
    repeated."""
    left, top, width, height = box
    if picture.shape[-2:] != (height, width):
        picture = F.interpolate(picture[None], (height, width), mode="bilinear", antialias=True)[0]
    rows = (torch.arange(size[0], device=picture.device) - top).clamp(0, height - 1)
    columns = (torch.arange(size[1], device=picture.device) - left).clamp(0, width - 1)
    return picture[:, rows[:, None], columns].clamp(0, 1)


def corners(boxes: Tensor) -> Tensor:
    """Return the corners of boxes (B, 4), (B, 4, 2) float64, x then y, clockwise from the upper
    left one."""
    left, top, width, height = boxes.double().unbind(1)
    x = torch.stack((left, left + width, left + width, left), 1)
    y = torch.stack((top, top, top + height, top + height), 1)
    return torch.stack((x, y), -1)


def distances(shot: Shot, boxes: Tensor, radii: Tensor) -> tuple[Tensor, Tensor]:
    """Return how far outside of their screen photo pixels look, and the size of a photo pixel
    there, both in pixels of the screen's plane, (B, 1, H, W) each; radii: (B, 1, 1, 1) of the
    screens' corners, in the same pixels."""
    frame, lens, dtype = shot.frame, shot.distortion, radii.dtype
    if lens is not None:
        lens = lens[0].to(dtype), lens[1].to(dtype)
    # where pixels look changes so slowly that one in `SPACING` is enough
    rows, cols = (
        torch.linspace(
            0.5, side - 0.5, -(-side // SPACING) + 1, dtype=torch.float32, device=radii.device
        )
        for side in shot.size
    )
    points = grids.grid(rows, cols).to(dtype).expand(len(shot), -1, -1, -1)
    points = points + frame.photo_corner(points)
    inverse = torch.linalg.inv(shot.matrix()).to(dtype)
    looks = grids.photo_to_image(points, inverse, frame.size, lens)
    looks = looks - frame.image_corner(looks)
    steps = grids.jacobian(points, inverse, frame.size, lens)
    pixel = torch.linalg.det(steps).abs().sqrt().clamp(min=1e-6)
    coarse = torch.stack((*looks.unbind(-1), pixel), 1)
    x, y, pixel = F.interpolate(coarse, shot.size, mode="bilinear", align_corners=True).split(1, 1)
    left, top, width, height = boxes.to(radii)[..., None, None].split(1, 1)
    across = (x - left - width / 2).abs() - (width / 2 - radii)
    down = (y - top - height / 2).abs() - (height / 2 - radii)
    beyond = torch.hypot(across.clamp(min=0), down.clamp(min=0))
    return beyond + torch.maximum(across, down).clamp(max=0) - radii, pixel
