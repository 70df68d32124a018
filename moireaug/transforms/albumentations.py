"""The albumentations transforms: RandomMoire and AdversarialMoire for numpy images in an
`albumentations.Compose`, of albumentations or of AlbumentationsX 2.0 to 2.5."""

# ruff: noqa: E402  # a missing extra is named before it is imported

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

from moireaug.common.extras import require

require("albumentations", "moireaug.transforms.albumentations")

# albumentations asks a server for its newest version when it is imported, which hangs where there
# is no network
os.environ.setdefault("NO_ALBUMENTATIONS_UPDATE", "1")

import numpy as np
import torch
from albumentations.core.type_definitions import ALL_TARGETS

from moireaug.attacks import MoireAttack
from moireaug.common.argument_checks import check_probability
from moireaug.mixtures import SceneLike, sample_one, scenes_of
from moireaug.scenes import Shot
from moireaug.transforms._albumentations_base import Params, SampledTransform, torch_generator
from moireaug.transforms._arrays import (
    IMAGE_TARGETS,
    apply_to_all,
    apply_to_one,
    move_bboxes,
    move_keypoints,
    move_mask,
    pictures_of,
)
from moireaug.transforms._convert import at_size
from moireaug.transforms._noise import attack_pictures, label_of, noise_of
from moireaug.transforms._scenes import describe, planned_scenes, warn_without_moire
from moireaug.transforms._workers import seed_worker as seed_worker


class RandomMoire(SampledTransform):
    """Photograph an image on a screen with probability `p`.

        A.Compose([A.HorizontalFlip(), RandomMoire(scene="screen_photo", p=0.5), A.Normalize()],
        seed=0)

    Args:
        scene: a Scene, a preset's name or a dict, or a list of these, a mixture: each call then
            photographs in one of them. The shot is drawn from the transform's own generator: seed
            it with `Compose(seed=)`, and in a DataLoader with `seed_worker`, without which workers
            repeat each other.
        p: probability of a photo, in [0, 1].
        shrink: as in `moireaug.transforms.RandomMoire`: images are parts of larger photos.

    Targets:
        image, mask, bboxes, keypoints, volume, mask3d

    Image types:
        uint8, float32

    Number of channels:
        1, 3

    Images are (H, W, 3), or (H, W) and (H, W, 1) for grey, which is shown as grey RGB and returned
    as luma; uint8, or any float in [0, 1], so use it before `A.Normalize`. Values a little outside
    are clipped, see `moireaug.common.image_checks`. Shape and dtype are kept; float64, which
    `image / 255.` is, is computed in float32. The pictures of `images` and the slices of a volume
    are frames of one shot, filmed by hand at 30 a second as by `Scene.sample_track`; in the
    camera's frame, by a camera that stands still. The first is the photo of `image`.

    Masks, bboxes and keypoints stay untouched, unless the scene leaves the photo in the camera's
    frame (`Develop(registered=False)` with a pose or a lens); then they move with the picture:
    masks to the nearest pixel, bboxes to those that enclose the moved ones, keypoints with their
    angle and scale, in albumentations' pixel-index coordinates. Bboxes may reach out of the photo:
    a Compose clips them, after `BboxParams(min_visibility=)` has compared their areas. A keypoint's
    angle is taken to run from x towards y, clockwise as seen; `A.Rotate` and `A.Affine` change it
    the other way round. The parameters are plain numbers: `ReplayCompose` and JSON can hold them,
    and a replay takes images of any size.

    Raises:
        TypeError, ValueError: an unknown keyword or scene, a p out of range, and images as above.
    """

    _targets = ALL_TARGETS

    def __init__(
        self,
        scene: SceneLike = "screen_photo",
        p: float = 0.5,
        shrink: float | tuple[float, float] | None = None,
    ) -> None:
        super().__init__(p=check_probability(p))
        self.scene = planned_scenes(scene, shrink)
        self._moves = self.scene.moves
        # building a scene again from its plain numbers takes longer than a draw
        self._scene_values = [(one, one.to_dict()) for one in scenes_of(self.scene)]

    def get_transform_init_args(self) -> Params:
        return {"scene": self.scene.to_dict()}

    def __repr__(self) -> str:
        args = self.get_base_init_args() | self.get_transform_init_args()
        other_args = "".join(f", {name}={args[name]!r}" for name in args if name != "scene")
        return f"{type(self).__name__}(scene={describe(self.scene)}{other_args})"

    def draw(self, params: Params, data: Params, random: np.random.Generator) -> Params:
        """Return one shot for images of the size in `params`, as plain numbers."""
        warn_without_moire(self.scene, params["shape"][:2])
        generator = torch_generator(random)
        return {"shot": sample_one(self.scene, params["shape"][:2], generator).to_dict()}

    def _shot(self, drawn: Params) -> Shot:
        """Return the Shot of plain numbers, which a replay may have from another transform."""
        for scene, values in self._scene_values:
            if drawn.get("scene") == values:
                return Shot.from_dict({**drawn, "scene": scene})
        return Shot.from_dict(drawn)

    def apply(self, img: np.ndarray, shot: Params, **params: Any) -> np.ndarray:
        return apply_to_one(img, self._shot(shot), noise_of("image", 1, **params))

    def apply_to_images(
        self, images: np.ndarray, shot: Params, target: str = "images", **params: Any
    ) -> np.ndarray:
        return apply_to_all(images, self._shot(shot), noise_of(target, len(images), **params))

    def apply_to_volume(self, volume: np.ndarray, **params: Any) -> np.ndarray:
        return self.apply_to_images(volume, target="volume", **params)

    def apply_to_mask(self, mask: np.ndarray, shot: Params, **params: Any) -> np.ndarray:
        return move_mask(mask, self._shot(shot)) if self._moves else mask

    def apply_to_masks(self, masks: np.ndarray, shot: Params, **params: Any) -> np.ndarray:
        return super().apply_to_masks(masks, shot=shot, **params) if self._moves else masks

    apply_to_mask3d = apply_to_masks

    def apply_to_bboxes(self, bboxes: np.ndarray, **params: Any) -> np.ndarray:
        return self._move_rows(bboxes, move_bboxes, **params)

    def apply_to_keypoints(self, keypoints: np.ndarray, **params: Any) -> np.ndarray:
        return self._move_rows(keypoints, move_keypoints, **params)

    def _move_rows(
        self, rows: np.ndarray, move: Callable, shot: Params, shape: Any, **params: Any
    ) -> np.ndarray:
        if not self._moves or not len(rows):
            return rows
        return move(rows, at_size(self._shot(shot), (shape[0], shape[1])))


class AdversarialMoire(RandomMoire):
    """Photograph an image on a screen with the noise of a Moiré Attack after its last step.

        A.Compose([AdversarialMoire(model, eps=4 / 255, steps=5, p=0.5)])(image=image, label=3)

    One image at a time is slow: where you have batches, use `moireaug.transforms.AdversarialMoire`.

    Args:
        model: (B, 3, H, W) images in [0, 1] to logits, or, for grey pictures, perhaps their luma
            (B, 1, H, W); it runs on the device of its parameters, and its state is kept.
        scene, p, shrink: as in RandomMoire. eps, bound, steps, step_size, loss, random_start: as in
            `attacks.MoireAttack`.
        label_key: the name under which the call passes the class of its images, an integer.
        name: name as in `A.Lambda`, which `to_dict` writes and
            `from_dict(..., nonserializable={name: transform})` looks up, because a model cannot be
            written.

    Targets and images as in RandomMoire; each image, and each slice of a volume, gets its own
    noise. Pictures in additional targets are refused: pass several as `images`. The noise is one of
    the parameters, as nested lists, so that `ReplayCompose.replay` needs no model, but images of
    the same size.

    Raises:
        ValueError, TypeError: as in RandomMoire and `attacks.MoireAttack`; a model that cannot be
            called; a call without the label; `to_dict` without a `name`.
    """

    def __init__(
        self,
        model: torch.nn.Module | Callable[[torch.Tensor], torch.Tensor],
        scene: SceneLike = "screen_photo",
        *,
        eps: float = 4 / 255,
        steps: int = 5,
        step_size: float | None = None,
        loss: str = "ce",
        random_start: float = 1.0,
        bound: str = "codes",
        label_key: str = "label",
        name: str | None = None,
        p: float = 0.5,
        shrink: float | tuple[float, float] | None = None,
    ) -> None:
        super().__init__(scene, p, shrink)
        self.label_key, self.name = label_key, name
        self._available_keys.add(label_key)  # or Compose(strict=True) refuses it
        self.attack = MoireAttack(
            model=model,
            scene=self.scene,
            eps=eps,
            steps=steps,
            step_size=step_size,
            loss=loss,
            random_start=random_start,
            bound=bound,
        )

    @classmethod
    def is_serializable(cls) -> bool:
        return False

    def to_dict_private(self) -> Params:
        if self.name is None:
            raise ValueError(
                "AdversarialMoire holds a model, which cannot be written: give it a name, and the "
                "transform itself to from_dict(..., nonserializable={name: transform})."
            )
        return {"__class_fullname__": self.get_class_fullname(), "__name__": self.name}

    def get_dict_with_id(self) -> Params:
        # a replay carries its noise, so it is written as a RandomMoire
        plain = {"__class_fullname__": RandomMoire.get_class_fullname(), "p": self.p}
        return {**plain, **super().get_transform_init_args(), "id": id(self)}

    def get_transform_init_args(self) -> Params:
        args = {"model": type(self.attack.model).__name__, **super().get_transform_init_args()}
        for name in ("eps", "bound", "steps", "step_size", "loss", "random_start"):
            args[name] = getattr(self.attack, name)
        return args

    def draw(self, params: Params, data: Params, random: np.random.Generator) -> Params:
        drawn = super().draw(params, data, random)
        label = label_of(data, self.label_key)
        generator = torch_generator(random)
        for key, kind in self._additional_targets.items():
            if kind in IMAGE_TARGETS and data.get(key) is not None:
                raise ValueError(
                    f"{key!r} is an additional target of kind {kind!r}, which would get the noise "
                    "of another picture. Pass the pictures of one call together, as images=."
                )
        pictures = pictures_of(data)
        if not any(pictures.values()):
            return drawn | {"noise": {}}
        shot = self._shot(drawn["shot"])
        noise = attack_pictures(self.attack, pictures, shot, label, generator)
        return drawn | {"noise": noise}
