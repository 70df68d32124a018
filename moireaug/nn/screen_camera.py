"""A screen and a camera in front of it, as a layer: images to photos, differentiable."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from kornia.geometry.transform import get_perspective_transform, warp_perspective
from torch import Tensor, nn

from moireaug.capture import capture
from moireaug.common.argument_checks import check_real, check_whole
from moireaug.common.image_checks import check_shape
from moireaug.mixtures import SceneLike
from moireaug.scene.mixed_shot import MixedShot, per_scene
from moireaug.scenes import Shot
from moireaug.synthesis.twins import without_moire
from moireaug.transforms._scenes import describe, planned_scenes, warn_without_moire

# the corners of a picture from the top left one clockwise, as shares of its sides
CORNERS = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))


class ScreenDraw(NamedTuple):
    """What `ScreenCamera` draws for a batch: another call with it takes the same photos.

    Args:
        shot: draw from the scene.
        corner_errors: (B, 4, 2) float32, by how many pixels, x then y, each corner of the screen is
            misplaced, from the top left one clockwise; None without jitter.
    """

    shot: Shot | MixedShot
    corner_errors: Tensor | None = None


class ScreenCamera(nn.Module):
    """Show images on a screen and photograph them: a layer between an encoder and a decoder, such
    as of a watermark or a code, that must be read from a photo.

        photos = ScreenCamera("screen_photo", shrink=(1, 3), jitter=2.0)(images)

    Args:
        scene: a Scene, a preset's name or a dict; or a list of these, a mixture: each image is then
            photographed in one of them.
        shrink: images are parts of larger photos, with so many sensor pixels per pixel, a number or
            a (low, high) pair; None leaves the scene as it is. See `Scene.with_shrink`.
        jitter: pixels by which a corner of the screen is found too far along x and along y, at
            most; drawn uniformly. The photo is brought to the image's frame by these corners, as by
            a detector's, with bilinear interpolation; past its edges its outermost pixels go on.
        seed: of the draws in evaluation mode.

    In training mode each call draws a shot for each image, from torch's global generator. In
    evaluation mode draws come from a generator that `eval()` sets to `seed`: a pass over a data set
    that begins with `eval()` takes the same photos each time, though two calls in it do not. So in
    both modes it says `randomised = True` to defences and evaluations. The seed of an evaluation
    does not reach these draws: call `eval()` before each `evaluate`.

    It has no weights and no buffers, and computes where the images are. Gradients reach the images,
    and a `noise` if given. torch.compile breaks the graph at a mixture of scenes.

    Raises:
        TypeError, ValueError: a scene that cannot be photographed; a jitter or a seed below 0; a
            jitter of a scene whose photos stay in the camera's frame.
    """

    randomised = True

    def __init__(
        self,
        scene: SceneLike = "screen_photo",
        *,
        shrink: float | tuple[float, float] | None = None,
        jitter: float = 0.0,
        seed: int = 0,
    ) -> None:
        super().__init__()
        self.scene = planned_scenes(scene, shrink)
        check_real("jitter", jitter, 0, or_low=True, unit="pixels")
        check_whole("seed", seed, 0, 2**63 - 1)
        if jitter and self.scene.moves:
            raise ValueError(
                f"jitter misplaces the corners that bring a photo to the image's frame; got "
                f"{jitter!r} for a scene whose photos stay in the camera's frame. Set "
                "Develop(registered=True), or jitter=0."
            )
        self.jitter, self.seed = float(jitter), int(seed)
        self._generator = torch.Generator().manual_seed(self.seed)

    def train(self, mode: bool = True) -> ScreenCamera:
        """Set training mode, or evaluation mode with its draws from the beginning."""
        if not mode:
            self._generator.manual_seed(self.seed)
        return super().train(mode)

    def forward(
        self, images: Tensor, draw: ScreenDraw | None = None, noise: Tensor | None = None
    ) -> Tensor:
        """Return the photos of images.

        Args:
            images: (B, 3, H, W) float in [0, 1], sRGB codes; clamp what an encoder makes.
            draw: a draw for this batch, which `draw` has made; None makes one.
            noise: an attacker's noise on the raw reading, of `draw.shot.raw_shape()`.

        Returns:
            (B, 3, H, W) in [0, 1], of the images' dtype.

        Raises:
            TypeError, ValueError: as `capture`; a draw of another type, such as a shot.
        """
        draw = self.draw(images) if draw is None else draw
        _check_draw(draw)
        return registered_by(capture(images, draw.shot, noise), draw.corner_errors)

    def twin(self, images: Tensor, draw: ScreenDraw) -> Tensor:
        """Return the same photos of a panel without subpixels; arguments, errors: as of a call."""
        _check_draw(draw)

        def photograph(shot: Shot, images: Tensor) -> Tensor:
            return capture(images, without_moire(shot))

        return registered_by(per_scene(draw.shot, photograph, images), draw.corner_errors)

    def draw(self, images: Tensor) -> ScreenDraw:
        """Draw for a batch of images (B, 3, H, W), as a call does."""
        check_shape(images)
        n, size = len(images), (images.shape[-2], images.shape[-1])
        warn_without_moire(self.scene, size)
        generator = None if self.training else self._generator
        shot = self.scene.sample(n, size, generator)
        if not self.jitter:
            return ScreenDraw(shot)
        fraction = torch.rand(n, 4, 2, generator=generator, dtype=torch.float32, device="cpu")
        return ScreenDraw(shot, self.jitter * (2 * fraction - 1))

    def extra_repr(self) -> str:
        return f"{describe(self.scene)}, jitter={self.jitter:g}"

    def __getstate__(self) -> dict[str, Any]:
        """Keep the generator as numbers: torch's own pickle of it fails in spawned processes."""
        return vars(self) | {"_generator": self._generator.get_state()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        generator = torch.Generator()
        generator.set_state(state["_generator"])
        super().__setstate__(state | {"_generator": generator})


def _check_draw(draw: object) -> None:
    if not isinstance(draw, ScreenDraw):
        raise TypeError(
            f"draw must be what camera.draw(images) returns; got a {type(draw).__name__}. Of a "
            "shot, make ScreenDraw(shot)."
        )


def registered_by(photos: Tensor, corner_errors: Tensor | None) -> Tensor:
    """Return photos (B, 3, H, W) in the frame of corners misplaced by (B, 4, 2) pixels."""
    if corner_errors is None or not len(photos):
        return photos
    height, width = photos.shape[-2:]
    sides = photos.new_tensor((width, height), dtype=torch.float32)
    corners = photos.new_tensor(CORNERS, dtype=torch.float32) * sides - 0.5  # centres are integers
    found = corners + corner_errors.to(corners)
    to_image = get_perspective_transform(found, corners.expand_as(found))
    with torch.autocast(photos.device.type, enabled=False):
        moved = warp_perspective(
            photos.float(), to_image, (height, width), padding_mode="border", align_corners=True
        )
    return moved.to(photos.dtype)
