"""The kornia transform: RandomMoire for batches, alone or in an `AugmentationSequential`, on any
device."""

from __future__ import annotations

from functools import partialmethod
from typing import Any

import torch
from kornia.augmentation import IntensityAugmentationBase2D
from torch import Tensor

from moireaug.common.argument_checks import check_probability
from moireaug.mixtures import Mixture, SceneLike, scenes_of
from moireaug.scene.by_name import values_of
from moireaug.scene.mixed_shot import MixedShot
from moireaug.scenes import Scene, Shot
from moireaug.transforms._convert import check_format, photograph
from moireaug.transforms._scenes import describe, planned_scenes, warn_without_moire


class RandomMoire(IntensityAugmentationBase2D):
    """Photograph images on a screen, each with probability `p`.

        AugmentationSequential(RandomHorizontalFlip(), RandomMoire("screen_photo", p=0.5),
        data_keys=["input", "mask"])

    Args:
        scene: a Scene, a preset's name or a dict, whose photos are brought back to the image's
            frame (`Develop(registered=True)`, or neither pose nor lens); or a list of these, a
            mixture: each image is then photographed in one of them.
        p: probability of a photo, in [0, 1].
        same_on_batch: all images share one draw, sensor noise included.
        keepdim: a (C, H, W) input comes back as (C, H, W), not as (1, C, H, W).
        images_only: take scenes that leave the photo in the camera's frame, too, as the paper's do,
            for images and class labels alone: masks, boxes and key points are then refused, but
            `inverse` leaves them as they are.
        shrink: as in `moireaug.transforms.RandomMoire`: images are parts of larger photos.

    Shapes: (B, C, H, W) or (C, H, W), C = 3, or 1 for grey, which is shown as grey RGB and returned
    as luma; floating point in [0, 1], so use it before `Normalize`. Values a little outside are
    clipped, see `moireaug.common.image_checks`. Dtype and device are kept; float64 is computed in
    float32. Differentiable in the images. Only the chosen images are computed; the others are
    returned unchanged. `torch.compile(fullgraph=True)` computes all, and checks no values.

    Convention: an intensity augmentation: masks, boxes and key points stay as they are,
    `transform_matrix` is the identity, and `inverse` leaves it out. The parameters hold the whole
    shot, so `seq(x, params=seq._params)` replays bit for bit; those of one image replay on all rows
    of a batch. Draws come from torch's global generator. In a `VideoSequential` with
    `same_on_frame=True`, frames share the sensor noise, too.

    Raises:
        TypeError, ValueError: a scene that leaves the photo in the camera's frame without
            `images_only`, as no matrix, by which kornia moves boxes and key points, holds a lens;
            with it, masks, boxes and key points. Also a p out of range, parameters of another
            number of images, and images as in `moireaug.capture`.
    """

    def __init__(
        self,
        scene: SceneLike = "screen_photo",
        p: float = 0.5,
        same_on_batch: bool = False,
        keepdim: bool = False,
        images_only: bool = False,
        shrink: float | tuple[float, float] | None = None,
    ) -> None:
        p = check_probability(p)
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim)
        if not isinstance(images_only, bool):
            raise TypeError(f"images_only must be True or False; got {images_only!r}.")
        self.scene = planned_scenes(scene, shrink)
        self.images_only = images_only
        if self.scene.moves and not images_only:
            raise ValueError(
                "kornia would leave masks, boxes and key points where they were, because this "
                "scene's photo stays in the camera's frame (Develop(registered=False)) and no "
                "matrix holds its lens. Set registered=True, or use "
                "moireaug.transforms.RandomMoire, which moves them and takes batches on the GPU, "
                "too; images_only=True takes the scene for images alone."
            )

    def __repr__(self) -> str:
        name, settings = super().__repr__().split("(", 1)
        images_only = "images_only=True, " if self.images_only else ""
        return f"{name}(scene={describe(self.scene)}, {images_only}{settings}"

    def generate_parameters(self, batch_shape: tuple[int, ...]) -> dict[str, Tensor]:
        n, size = batch_shape[0], (batch_shape[-2], batch_shape[-1])
        warn_without_moire(self.scene, size)
        if self.same_on_batch:
            return to_params(self.scene.sample(1, size).repeat(n))
        return to_params(self.scene.sample(n, size))

    def __batch_prob_generator__(
        self, batch_shape: tuple[int, ...], p: float, p_batch: float, same_on_batch: bool
    ) -> Tensor:
        """Draw which images are photographed, (B,) 0 or 1, as kornia does, but in float32: another
        default dtype would draw other numbers."""
        n = batch_shape[0]
        if p in (0, 1):
            return torch.full((n,), p, dtype=torch.float32, device=self.device)
        drawn = torch.rand(1 if same_on_batch else n, dtype=torch.float32, device=self.device)
        return (drawn < p).to(drawn).expand(n)

    def apply_transform(
        self,
        input: Tensor,
        params: dict[str, Tensor],
        flags: dict[str, Any],
        transform: Tensor | None = None,
    ) -> Tensor:
        check_format(input)
        shot = from_params(self.scene, (input.shape[-2], input.shape[-1]), params)
        chosen = torch.atleast_1d(params["batch_prob"] > 0.5)
        if len(shot) == len(chosen) == 1:
            shot, chosen = shot.repeat(len(input)), chosen.expand(len(input))
        if not len(shot) == len(chosen) == len(input):
            raise ValueError(
                f"the parameters are of {len(shot)} images; got {len(input)}. Replay them on a "
                "batch of that size, or those of one image on any."
            )
        if torch.compiler.is_compiling():
            # kornia puts back images that were not chosen; a graph cannot leave them out
            return photograph(input, shot)
        if not chosen.any():
            return input
        if chosen.all():
            return photograph(input, shot)
        rows = chosen.nonzero().flatten().to(input.device)
        photos = photograph(input[rows], shot[rows.to(shot.device)])
        return input.clone().index_copy_(0, rows, photos)

    def _unmoved(self, annotations: str, input: Any, *args: Any, **kwargs: Any) -> Any:
        if self.scene.moves:
            raise ValueError(
                f"images_only=True takes no {annotations}: this scene's photo stays in the "
                "camera's frame (Develop(registered=False)), and they would not move with it. Set "
                "registered=True, or use moireaug.transforms.RandomMoire, which moves them."
            )
        return input

    apply_transform_mask = partialmethod(_unmoved, "masks")
    apply_transform_box = partialmethod(_unmoved, "boxes")
    apply_transform_keypoint = partialmethod(_unmoved, "key points")


def to_params(shot: Shot | MixedShot) -> dict[str, Tensor]:
    """Return a shot as kornia's parameters of a draw: (B,) tensors such as view_yaw, seed and, of a
    mixture, scene."""
    drawn = {name.replace(".", "_"): values for name, values in shot.numbers().items()}
    if isinstance(shot, MixedShot):
        drawn["scene"] = shot.scene_index
    return {**drawn, "seed": shot.seed}


def from_params(
    scene: Scene | Mixture, size: tuple[int, int], params: dict[str, Tensor]
) -> Shot | MixedShot:
    """Return the inverse of `to_params`, for images of `size` (height, width); parameters of a
    mixture for one scene, or of one scene for a mixture, are refused: ValueError."""
    mixed = isinstance(scene, Mixture)
    if mixed != ("scene" in params):
        drawn_by = "one scene" if mixed else "a list of scenes"
        raise ValueError(
            f"these parameters were drawn by a transform of {drawn_by}; got a transform of "
            f"{describe(scene)}. Replay them by one with the same scene."
        )
    drawn = {n: params[n.replace(".", "_")] for n in values_of(scenes_of(scene)[0])}
    if isinstance(scene, Scene):
        return scene.shot_from_numbers(size, drawn, params["seed"])
    index, seed = params["scene"], params["seed"]
    return MixedShot(scenes=scene.scenes, scene_index=index, size=size, drawn=drawn, seed=seed)
