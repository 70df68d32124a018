"""The torchvision v2 transform: RandomMoire for tensors, tv_tensors and PIL images, alone or in a
`v2.Compose`."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torchvision.transforms import v2
from torchvision.transforms.v2 import functional as F

from moireaug.common.argument_checks import check_probability
from moireaug.mixtures import SceneLike, draw_one
from moireaug.scene.mixed_shot import MixedShot
from moireaug.scenes import Shot
from moireaug.transforms._leaves import (
    ANNOTATION_TYPES,
    IMAGE_TYPES,
    apply_shot,
    check_annotation,
    check_image,
    draw_count,
    refuse_arrays,
)
from moireaug.transforms._scenes import describe, planned_scenes, warn_without_moire


class RandomMoire(v2.Transform):
    """Photograph images on a screen, each with probability `p`.

        v2.Compose([v2.RandomHorizontalFlip(), RandomMoire(scene="screen_photo", p=0.5),
        v2.Normalize(mean, std)])

    Args:
        scene: a Scene, a preset's name or a dict, or a list of these, a mixture: each image is then
            photographed in one of them. "anywhere" is the mixture of every screen. One shot is
            drawn per image, from torch's global generator: DataLoader workers differ, and
            `torch.manual_seed` makes draws reproducible.
        p: probability of a photo, in [0, 1].
        shrink: images are crops, parts of larger photos with so many sensor pixels per image pixel,
            a number or a (low, high) pair: 1 is the camera's own resolution, 3 that of a photo of
            3000 pixels sent as 1000. None: images are what the scene says, in presets whole photos,
            in which little moiré is left below 200 pixels. See `Scene.with_shrink`.

    Images are pure tensors and `tv_tensors.Image` ([B,] C, H, W), `tv_tensors.Video` ([B,] T, C, H,
    W) and PIL images of mode RGB, L, RGBA or LA; C is 3, or 1 for grey, which is shown as grey RGB
    and returned as luma; uint8 or floating point in [0, 1], so use it before `v2.Normalize`. Values
    a little outside are clipped, see `moireaug.common.image_checks`. Type, shape, dtype, device and
    memory layout are kept; float64 is computed in float32. Inputs are never modified.

    A batch (B, C, H, W) has one draw per image; images that are not chosen are returned unchanged.
    A video is one shot, filmed by hand at 30 frames a second as by `Scene.sample_track`; in the
    camera's frame, by a camera that stands still. Images of one sample share the draw.
    Differentiable in floating-point images.

    Labels, masks, boxes and key points are returned as the same objects, unless the scene, or one
    of a list, leaves the photo in the camera's frame (`Develop(registered=False)` with a pose or a
    lens): then masks, boxes, key points and a PIL image's alpha move with the picture. Boxes become
    those that enclose the moved ones, clamped to the canvas unless their `clamping_mode` is None;
    key points may leave the photo; both are in continuous coordinates, with pixel centres at half
    integers. Integer ones are rounded.

    Raises:
        TypeError, ValueError: an unknown scene, a p out of range, another number of channels, dtype
            or PIL mode, numpy arrays, float images that cannot be pictures in [0, 1], images of
            different batch sizes in one sample; in the camera's frame also rotated boxes, and boxes
            or key points that cannot be told apart by image.
    """

    def __init__(
        self,
        scene: SceneLike = "screen_photo",
        p: float = 0.5,
        shrink: float | tuple[float, float] | None = None,
    ) -> None:
        super().__init__()
        self.scene = planned_scenes(scene, shrink)
        self.p = check_probability(p)
        annotations = ANNOTATION_TYPES if self.scene.moves else ()
        self._transformed_types = IMAGE_TYPES + annotations

    def check_inputs(self, flat_inputs: list[Any]) -> None:
        needs_transform = self._needs_transform_list(flat_inputs)
        leaves = [x for x, needed in zip(flat_inputs, needs_transform, strict=True) if needed]
        images = [x for x in leaves if not isinstance(x, ANNOTATION_TYPES)]
        refuse_arrays(flat_inputs, images)
        for image in images:
            check_image(image)
        counts = sorted({draw_count(image) for image in images})
        if len(counts) > 1:
            raise ValueError(
                "images of one sample must have one batch size; got "
                f"{' and '.join(map(str, counts))}."
            )
        for leaf in (x for x in leaves if isinstance(x, ANNOTATION_TYPES)):
            check_annotation(leaf, *counts)

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        images = (x for x in flat_inputs if not isinstance(x, ANNOTATION_TYPES))
        n = next(map(draw_count, images), 1)
        chosen = (torch.rand(n, dtype=torch.float32, device="cpu") < self.p).nonzero().flatten()
        u = self.scene.random_numbers(n)
        shots = {}
        if len(chosen):  # one for each size, of all leaves
            sizes = dict.fromkeys(tuple(F.get_size(leaf)) for leaf in flat_inputs)
            shots = {size: self._shot(u[chosen], size) for size in sizes}
        return {"rows": None if len(chosen) == n else chosen, "shots": shots}

    def _shot(self, u: Tensor, size: tuple[int, int]) -> Shot | MixedShot:
        """Return the shot that random numbers give, of images of `size` (height, width)."""
        warn_without_moire(self.scene, size)
        if len(u) == 1:  # of one scene: a mixture's takes three times as long
            return draw_one(self.scene, u, size)
        return self.scene.draw(u, size)

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        if not params["shots"]:
            return inpt
        return apply_shot(inpt, params["shots"][tuple(F.get_size(inpt))], params["rows"])

    def extra_repr(self) -> str:
        return f"p={self.p}, scene={describe(self.scene)}"
