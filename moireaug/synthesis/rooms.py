"""Screens in rooms: photos in which a whole screen is seen, with its bezel and what is around it.

The light of the screen's plane and that of the room, without noise and saturation, are joined by
antialiased masks, and then read and developed once: noise, tone and JPEG are those of one photo.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from moireaug.camera.effects.srgb import codes_of_light, light_of_codes
from moireaug.capture import develop
from moireaug.common.image_checks import check_images
from moireaug.common.numeric import per_image, widen_half
from moireaug.mixtures import SceneLike, as_scenes, map_scenes, scenes_of
from moireaug.scene.by_name import with_values
from moireaug.scene.fields import Part, Range, bounds, ranged
from moireaug.scene.mixed_shot import join_rows, per_scene
from moireaug.scenes import Scene, Shot
from moireaug.synthesis.room_light import light_of_room, light_of_screen, read
from moireaug.synthesis.screen_places import SPACING, boxes_of, corners, distances, on_plane

GLOSS = 0.3  # of a bezel: share of its light that mirrors the room, and is not its mean


@dataclass(frozen=True, kw_only=True)
class Room(Part):
    """How a screen stands in a room. All fields are ranges, drawn uniformly for each photo.

    Args:
        extent: size of the screen before it is turned, as a share of the largest of its shape that
            fits into the photo; above 1, it extends beyond it.
        place_x, place_y: where the screen lies in the photo: 0 at the left or upper edge, 1 at the
            right or lower one.
        bezel: width of the bezel, as a share of the screen's shorter side.
        corner: radius of the screen's corners, as a share of its shorter side; the bezel's are
            rounder by its width.
        albedo: light that the bezel reflects, as a share of the room's.
        ambient: light of the room, as a share of what its picture shows on the screen.
        glow: light of the screen on what is next to it, as a share of the screen's mean.
        reflection: light of the room that the glass mirrors, as a share; the scene's `Panel.glare`
            adds to it.
        blur: width over which the room is out of focus, in photo pixels; below 2 it is sharp.
    """

    extent: Range = ranged((0.4, 1.1), 0.01, 10.0)
    place_x: Range = ranged((0.0, 1.0), 0.0, 1.0)
    place_y: Range = ranged((0.0, 1.0), 0.0, 1.0)
    bezel: Range = ranged((0.01, 0.1), 0.0, 1.0)
    corner: Range = ranged((0.0, 0.08), 0.0, 0.5)
    albedo: Range = ranged((0.0, 0.3), 0.0, 2.0)
    ambient: Range = ranged((0.05, 1.0), 0.0, 10.0)
    glow: Range = ranged((0.0, 0.2), 0.0, 10.0)
    reflection: Range = ranged((0.0, 0.1), 0.0, 1.0)
    blur: Range = ranged((0.0, 16.0), 0.0, 1000.0, "photo pixels")

    def draw(self, n: int, generator: torch.Generator | None = None) -> dict[str, Tensor]:
        """Draw each field for n photos: (n,) float64 by name."""
        u = torch.rand(n, len(self.ranged), dtype=torch.float64, generator=generator, device="cpu")
        drawn = {}
        for name, share in zip(self.ranged, u.unbind(1), strict=True):
            low, high = bounds(getattr(self, name))
            drawn[name] = low + (high - low) * share
        return drawn


class RoomPhotos(NamedTuple):
    """Photos of screens in rooms.

    photos: (B, 3, H, W) in [0, 1], sRGB codes.
    quadrilaterals: (B, 4, 2) float64, the screens' corners in the photos, x then y in pixels, from
        the picture's upper left one clockwise. Some may lie outside of the photo.
    shares: (B,) float64, share of the photo that the screen takes.
    """

    photos: Tensor
    quadrilaterals: Tensor
    shares: Tensor


@torch.no_grad()
def screen_in_room(
    pictures: Tensor,
    surroundings: Tensor,
    scene: SceneLike,
    room: Room | None = None,
    *,
    shrink: float | tuple[float, float] | None = None,
    generator: torch.Generator | None = None,
) -> RoomPhotos:
    """Return photos in which a screen that shows a picture is seen in a room.

    A photo has the size of its surroundings; the screen has the shape of its picture, and its place
    and size are drawn by `room`, its pose and camera by `scene`, whose photo is left in the
    camera's frame. Where the screen fills the photo, that is what `capture` returns.

    Args:
        pictures: (B, 3, h, w) float in [0, 1], sRGB codes.
        surroundings: (B, 3, H, W) float in [0, 1], of any size.
        scene: a Scene, a preset's name or a dict, or a list of these, a mixture. It is of the plane
            in which the screen lies: with `Sensor.pitch`, a larger screen has more panel pixels.
        room: see `Room`; None is `Room()`.
        shrink: sensor pixels per photo pixel, see `Scene.with_shrink`; None leaves scenes as is.
        generator: of the draws; None is torch's global one.

    Raises:
        TypeError, ValueError: pictures or surroundings that `capture` refuses, or of different
            numbers; a scene of a full reading; a room that is no `Room`.
    """
    pictures, surroundings = check_images(pictures), check_images(surroundings)
    dtype, pictures, surroundings = pictures.dtype, widen_half(pictures), widen_half(surroundings)
    if len(pictures) != len(surroundings):
        raise ValueError(
            "a photo needs a picture and its surroundings; got "
            f"{len(pictures)} and {len(surroundings)}. Repeat the fewer."
        )
    room = Room() if room is None else room
    if not isinstance(room, Room):
        raise TypeError(f"room must be a moireaug.synthesis.Room; got {room!r}.")
    scenes = map_scenes(as_scenes(scene, shrink), _in_cameras_frame)
    for one in scenes_of(scenes):
        if not one.is_binned:
            raise ValueError(
                "a screen in a room needs a binned reading, whose scene states Panel.width, "
                "Sensor.pitch or Sensor.shrink; got one of a full reading."
            )
    height, width = surroundings.shape[-2:]
    size, shape = (height, width), (pictures.shape[-2], pictures.shape[-1])
    shot = scenes.sample(len(pictures), size, generator)
    drawn = room.draw(len(pictures), generator)
    boxes = boxes_of(shape, size, drawn)
    planes = torch.empty_like(surroundings)
    for plane, picture, box in zip(planes, pictures, boxes.tolist(), strict=True):
        plane.copy_(on_plane(picture, box, size))
    rooms = _rooms(surroundings, drawn)
    numbers = torch.stack(list(drawn.values()), 1)
    taken = per_scene(shot, _photograph, planes, rooms, boxes, numbers, join=_join)
    return RoomPhotos(taken[0].to(dtype), *taken[1:])


@functools.lru_cache(maxsize=64)
def _in_cameras_frame(scene: Scene) -> Scene:
    return with_values(scene, {"develop.registered": False})


def _rooms(surroundings: Tensor, drawn: dict[str, Tensor]) -> Tensor:
    """Return the rooms' light, out of focus and dimmed, (B, 3, H, W)."""
    size, light = surroundings.shape[-2:], light_of_codes(surroundings)
    for room, width in zip(light, drawn["blur"].tolist(), strict=True):
        if width >= 2:
            small = [max(1, round(side / width)) for side in size]
            coarse = F.interpolate(room[None], small, mode="area")
            room.copy_(F.interpolate(coarse, size, mode="bicubic")[0].clamp(0, 1))
    ambient = drawn["ambient"].to(surroundings)[:, None, None, None]
    return ambient * light


def _photograph(
    shot: Shot, planes: Tensor, rooms: Tensor, boxes: Tensor, numbers: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Return the `RoomPhotos` of one scene's images.

    planes, rooms: (B, 3, H, W), codes of the screens' planes, and light of the rooms.
    boxes: see `boxes_of`. numbers: (B, fields) float64, of `Room.draw`.
    """
    drawn = dict(zip(Room.ranged, numbers.to(planes).unbind(1), strict=True))
    shorter = boxes[:, 2:].amin(1).to(planes)
    bezel, corner = (per_image(drawn[name] * shorter, planes) for name in ("bezel", "corner"))
    distance, pixel = distances(shot.to(planes.device), boxes, corner)
    inside = (0.5 - distance / pixel).clamp(0, 1)
    framed = (0.5 - (distance - bezel) / pixel).clamp(0, 1)
    falloff = torch.exp(-distance.clamp(min=0) / per_image(shorter, planes))
    glow = per_image(drawn["glow"], planes) * _mean_light(planes, inside) * falloff
    codes = codes_of_light((rooms + glow).clamp(0, 1)).clamp(0, 1)
    around = light_of_room(codes, shot)
    mirrored = around.flip(-1)
    lit = (1 - GLOSS) * around.mean((2, 3), keepdim=True) + GLOSS * mirrored
    rim = per_image(drawn["albedo"], planes) * lit
    screen = light_of_screen(planes, shot)
    screen = screen + per_image(drawn["reflection"], planes) * mirrored
    light = inside * screen + (framed - inside) * rim + (1 - framed) * around
    raw = read(light, shot, inside)
    return develop(raw, shot), shot.to_photo(corners(boxes)), inside.double().mean((1, 2, 3)).cpu()


def _mean_light(planes: Tensor, inside: Tensor) -> Tensor:
    """Return the mean light (B, 3, 1, 1) of screens, from some of their planes' pixels, of which
    they take the shares `inside` (B, 1, H, W)."""
    some = (..., slice(None, None, SPACING), slice(None, None, SPACING))
    mean = (light_of_codes(planes[some]) * inside[some]).mean((2, 3), keepdim=True)
    return mean / inside[some].mean((2, 3), keepdim=True).clamp(min=0.01)


def _join(rows: list[Tensor], parts: list[tuple[Tensor, Tensor, Tensor]]) -> tuple[Tensor, ...]:
    return tuple(join_rows(rows, values) for values in zip(*parts, strict=True))
