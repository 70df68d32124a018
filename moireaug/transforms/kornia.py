"""The kornia door: RandomMoire for batches, alone or in an `AugmentationSequential`, on any device."""

from __future__ import annotations

import dataclasses
from typing import Any

from kornia.augmentation import IntensityAugmentationBase2D
from torch import Tensor

from moireaug.fields import ranged_fields
from moireaug.parts import PARTS
from moireaug.scene import Scene, as_scene
from moireaug.shot import Shot
from moireaug.transforms._convert import check_probability, moves, photograph


class RandomMoire(IntensityAugmentationBase2D):
    """Photograph images on a screen, each with probability `p`.

        AugmentationSequential(RandomHorizontalFlip(), RandomMoire("screen_photo", p=0.5), data_keys=["input", "mask"])

    Args:
        scene: a Scene, a preset's name or a dict, whose photos are brought back to the image's frame
            (`Develop(registered=True)`, or neither pose nor lens).
        p: probability of a photo, in [0, 1].
        same_on_batch: all images share one draw, sensor noise included.
        keepdim: a (C, H, W) input comes back as (C, H, W), not as (1, C, H, W).

    Shapes: (B, C, H, W) or (C, H, W), C = 3, or 1 for grey, which is shown as grey RGB and returned as luma; floating
    point in [0, 1], so use it before `Normalize`. Dtype and device are kept. Differentiable in the images. Only the
    chosen images are computed; the others come back with their values.

    Convention: an intensity augmentation: masks, boxes and key points stay as they are, `transform_matrix` is the
    identity, and `inverse` leaves it out. The parameters hold the whole shot, so `seq(x, params=seq._params)` replays
    bit for bit. Draws come from torch's global generator.

    Raises:
        ValueError: a scene that leaves the photo in the camera's frame: kornia moves boxes and key points by a matrix
            alone, and no matrix holds a lens. Also a p out of range, and images as in `moireaug.capture`.
    """

    def __init__(
        self,
        scene: Scene | str | dict = "screen_photo",
        p: float = 0.5,
        same_on_batch: bool = False,
        keepdim: bool = False,
    ) -> None:
        super().__init__(p=check_probability(p), same_on_batch=same_on_batch, keepdim=keepdim)
        self.scene = as_scene(scene)
        if moves(self.scene):
            raise ValueError(
                "kornia would leave masks, boxes and key points where they were, because this scene's photo stays in "
                "the camera's frame (Develop(registered=False)) and no matrix holds its lens. Set registered=True, or "
                "use moireaug.transforms.RandomMoire, which moves them and takes batches on the GPU, too."
            )

    def generate_parameters(self, batch_shape: tuple[int, ...]) -> dict[str, Tensor]:
        n, size = batch_shape[0], (batch_shape[-2], batch_shape[-1])
        if self.same_on_batch:
            return to_params(self.scene.sample(1, size).repeat(n))
        return to_params(self.scene.sample(n, size))

    def apply_transform(
        self, input: Tensor, params: dict[str, Tensor], flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        chosen = (params["batch_prob"] > 0.5).nonzero().flatten()
        if not len(chosen):
            return input
        shot = from_params(self.scene, (input.shape[-2], input.shape[-1]), params)
        if len(chosen) == len(input):
            return photograph(input, shot)
        rows = chosen.to(input.device)
        return input.index_copy(0, rows, photograph(input[rows], shot[chosen.to(shot.device)]))


def to_params(shot: Shot) -> dict[str, Tensor]:
    """A shot as (B,) tensors named part_field, and seed: what kornia keeps of a draw."""
    drawn = {
        f"{part}_{k}": getattr(getattr(shot, part), k) for part in PARTS for k in ranged_fields(getattr(shot, part))
    }
    return {**drawn, "seed": shot.seed}


def from_params(scene: Scene, size: tuple[int, int], params: dict[str, Tensor]) -> Shot:
    """The inverse of `to_params`, for images of `size` (height, width)."""
    parts = {}
    for name in PARTS:
        part = getattr(scene, name)
        parts[name] = dataclasses.replace(part, **{k: params[f"{name}_{k}"] for k in ranged_fields(part)})
    return Shot(scene=scene, size=size, seed=params["seed"], **parts)
