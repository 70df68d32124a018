"""The albumentations door: RandomMoire and AdversarialMoire for numpy images in an `albumentations.Compose`."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from typing import Any

# albumentations asks a server for its newest version when it is imported, which hangs where there is no network
os.environ.setdefault("NO_ALBUMENTATIONS_UPDATE", "1")

import numpy as np
import torch
from albumentations.core import transforms_interface
from albumentations.core.composition import BaseCompose
from albumentations.core.transforms_interface import BasicTransform, DualTransform
from albumentations.core.type_definitions import ALL_TARGETS

from moireaug.attacks import MoireAttack
from moireaug.scene import Scene, as_scene
from moireaug.shot import Shot
from moireaug.transforms._convert import as_shown, at_size, check_probability, move_boxes, moves, photograph


class RandomMoire(DualTransform):
    """Photograph an image on a screen with probability `p`.

        A.Compose([A.HorizontalFlip(), RandomMoire(scene="screen_photo", p=0.5), A.Normalize()], seed=0)

    Args:
        scene: a Scene, a preset's name or a dict. The shot is drawn from the transform's own generator: seed it by
            `Compose(seed=)`, and in a DataLoader with `seed_worker`, without which workers repeat each other.
        p: probability of a photo, in [0, 1].

    Targets: image (H, W, 3), or (H, W) and (H, W, 1) for grey, which is shown as grey RGB and returned as luma; uint8,
    or float in [0, 1], so use it before `A.Normalize`; images and volumes share one shot. Shape and dtype are kept.

    Masks, bboxes and keypoints stay untouched, unless the scene leaves the photo in the camera's frame
    (`Develop(registered=False)` with a pose or a lens): then they move with the picture: masks to the nearest pixel,
    bboxes to those that enclose the moved ones, clamped to the photo, keypoints with their angle and scale, in
    albumentations' pixel-index coordinates. The parameters are plain numbers: `ReplayCompose` and JSON hold them.

    Raises:
        TypeError, ValueError: an unknown keyword or scene, a p out of range, and images as above.
    """

    _targets = ALL_TARGETS

    def __init__(self, scene: Scene | str | dict = "screen_photo", p: float = 0.5) -> None:
        super().__init__(p=check_probability(p))
        self.scene = as_scene(scene)
        self._moves = moves(self.scene)

    def get_transform_init_args(self) -> dict[str, Any]:
        return {"scene": self.scene.to_dict()}

    def draw(self, params: dict[str, Any], data: dict[str, Any], random: np.random.Generator) -> dict[str, Any]:
        """One shot of images of the size in `params`, as plain numbers."""
        generator = torch.Generator().manual_seed(int(random.integers(2**63)))
        return {"shot": self.scene.sample(1, params["shape"][:2], generator).to_dict()}

    if hasattr(DualTransform, "sample_parameters"):  # albumentationsx, which refuses the other name

        def sample_parameters(self, params: dict[str, Any], data: dict[str, Any], targets: Any, sampling: Any) -> Any:
            return transforms_interface.SampledParams(params=self.draw(params, data, sampling.random_generator))

    else:

        def get_params_dependent_on_data(self, params: dict[str, Any], data: dict[str, Any]) -> dict[str, Any]:
            return self.draw(params, data, self.random_generator)

    def apply(self, img: np.ndarray, shot: dict[str, Any], **params: Any) -> np.ndarray:
        return apply_shot(img, Shot.from_dict(shot))

    def apply_to_mask(self, mask: np.ndarray, shot: dict[str, Any], **params: Any) -> np.ndarray:
        return _move_mask(mask, Shot.from_dict(shot)) if self._moves else mask

    def apply_to_masks(self, masks: np.ndarray, shot: dict[str, Any], **params: Any) -> np.ndarray:
        return super().apply_to_masks(masks, shot=shot, **params) if self._moves else masks

    def apply_to_mask3d(self, mask3d: np.ndarray, shot: dict[str, Any], **params: Any) -> np.ndarray:
        return self.apply_to_masks(mask3d, shot=shot, **params)

    def apply_to_masks3d(self, masks3d: np.ndarray, shot: dict[str, Any], **params: Any) -> np.ndarray:
        return np.stack([self.apply_to_masks(m, shot=shot, **params) for m in masks3d]) if self._moves else masks3d

    def apply_to_bboxes(self, bboxes: np.ndarray, shot: dict[str, Any], **params: Any) -> np.ndarray:
        return _move_bboxes(bboxes, Shot.from_dict(shot)) if self._moves and len(bboxes) else bboxes

    def apply_to_keypoints(self, keypoints: np.ndarray, shot: dict[str, Any], **params: Any) -> np.ndarray:
        return _move_keypoints(keypoints, Shot.from_dict(shot)) if self._moves and len(keypoints) else keypoints


class AdversarialMoire(RandomMoire):
    """Photograph an image on a screen with the noise on the raw reading that fools a model most.

        A.Compose([AdversarialMoire(model, eps=4 / 255, steps=5, p=0.5)])(image=image, label=3)

    One image at a time is slow: where a batch can be had, use `moireaug.transforms.AdversarialMoire`.

    Args:
        model: (1, 3, H, W) images in [0, 1] to logits; it is asked on the device of its parameters, and left as it is.
        scene, p: as in RandomMoire. eps, steps, step_size, loss, random_start: as in `attacks.MoireAttack`.
        label_key: the name under which the call passes the image's class, an integer.

    Targets and replay as in RandomMoire; the noise is one of the parameters, as nested lists.

    Raises:
        ValueError, TypeError: as in RandomMoire and `attacks.MoireAttack`; a call without the label.
    """

    def __init__(
        self,
        model: torch.nn.Module | Callable[[torch.Tensor], torch.Tensor],
        scene: Scene | str | dict = "screen_photo",
        *,
        eps: float = 4 / 255,
        steps: int = 5,
        step_size: float | None = None,
        loss: str = "ce",
        random_start: float = 1.0,
        label_key: str = "label",
        p: float = 0.5,
    ) -> None:
        super().__init__(scene, p)
        self.label_key = label_key
        self.attack = MoireAttack(
            model=model, scene=self.scene, eps=eps, steps=steps, step_size=step_size, loss=loss,
            random_start=random_start,
        )  # fmt: skip

    def get_transform_init_args(self) -> dict[str, Any]:
        a = self.attack
        settings = {"eps": a.eps, "steps": a.steps, "step_size": a.step_size, "loss": a.loss}
        model = type(a.model).__name__  # a model is no plain value: only its name is recorded
        return {"model": model, **super().get_transform_init_args(), **settings, "random_start": a.random_start}

    def draw(self, params: dict[str, Any], data: dict[str, Any], random: np.random.Generator) -> dict[str, Any]:
        drawn = super().draw(params, data, random)
        if self.label_key not in data:
            raise ValueError(
                f"AdversarialMoire needs the image's class: call the Compose with {self.label_key}=<int>, or name "
                f"another key by label_key; got the keys {', '.join(sorted(data))}."
            )
        parameters = getattr(self.attack.model, "parameters", lambda: iter(()))()
        device = next((p.device for p in parameters), torch.device("cpu"))
        generator = torch.Generator().manual_seed(int(random.integers(2**63)))
        result = self.attack(
            as_shown(_planes(data["image"])).to(device), torch.tensor([int(data[self.label_key])]),
            shot=Shot.from_dict(drawn["shot"]), generator=generator,
        )  # fmt: skip
        return drawn | {"noise": result.noise.cpu().tolist()}

    def apply(self, img: np.ndarray, shot: dict[str, Any], noise: list | None = None, **params: Any) -> np.ndarray:
        return apply_shot(img, Shot.from_dict(shot), torch.tensor(noise))


def apply_shot(image: np.ndarray, shot: Shot, noise: torch.Tensor | None = None) -> np.ndarray:
    """The photo of one image, (H, W, 3), (H, W, 1) or (H, W), uint8 or float in [0, 1], in its shape and dtype."""
    return photograph(_planes(image), shot, noise)[0].permute(1, 2, 0).reshape(image.shape).numpy()


def _planes(image: np.ndarray) -> torch.Tensor:
    """(1, C, H, W) of an image (H, W, C) or (H, W)."""
    if image.ndim not in (2, 3):
        raise ValueError(f"an image must have the shape (H, W, C) or (H, W); got {image.shape}.")
    return torch.from_numpy(np.array(image, order="C")).reshape(1, *image.shape[:2], -1).permute(0, 3, 1, 2)


def _move_mask(mask: np.ndarray, shot: Shot) -> np.ndarray:
    # torch moves few unsigned types, and moving them needs their bits alone
    bits = mask.view(f"i{mask.itemsize}") if mask.dtype.kind == "u" else mask
    planes = torch.from_numpy(np.array(bits, order="C")).reshape(1, *mask.shape[:2], -1).permute(0, 3, 1, 2)
    moved = at_size(shot, mask.shape[:2]).to_photo_mask(planes)[0].permute(1, 2, 0).reshape(mask.shape)
    return moved.numpy().view(mask.dtype)


def _move_bboxes(bboxes: np.ndarray, shot: Shot) -> np.ndarray:
    """Rows of x1, y1, x2, y2 as fractions of the photo, and anything after."""
    h, w = shot.size
    pixels = torch.from_numpy(bboxes[:, :4].astype(np.float64)) * torch.tensor([w, h, w, h])
    moved = bboxes.copy()
    moved[:, :4] = (move_boxes(pixels, shot) / torch.tensor([w, h, w, h])).clamp(min=0, max=1).numpy()
    return moved


def _move_keypoints(keypoints: np.ndarray, shot: Shot) -> np.ndarray:
    """Rows of x, y, z, angle, scale, and anything after: angle in radians, from x towards y."""
    step = 1e-3  # pixels, to see how the photo turns and magnifies around each point
    at = torch.from_numpy(keypoints[:, :2].astype(np.float64)) + 0.5
    angle = torch.from_numpy(keypoints[:, 3].astype(np.float64))
    along = torch.stack([angle.cos(), angle.sin()], -1) * step
    across = torch.stack([-angle.sin(), angle.cos()], -1) * step
    there, ahead, aside = (shot.to_photo(points[None])[0] for points in (at, at + along, at + across))
    ahead, aside = (ahead - there) / step, (aside - there) / step
    moved = keypoints.copy()
    moved[:, :2] = (there - 0.5).numpy()
    moved[:, 3] = (torch.atan2(ahead[:, 1], ahead[:, 0]) % (2 * np.pi)).numpy()
    moved[moved[:, 3] >= 2 * np.pi, 3] = 0.0  # where rounding closed the circle, which albumentations refuses
    moved[:, 4] *= torch.linalg.det(torch.stack([ahead, aside], -1)).abs().sqrt().numpy()
    return moved


def seed_worker(worker_id: int) -> None:
    """Seed the albumentations transforms of a DataLoader's data set, for `DataLoader(..., worker_init_fn=seed_worker)`.

    Without it workers repeat each other's draws, and with `Compose(seed=)` every epoch repeats the first. The seeds
    follow torch's: distinct per worker and epoch, the same after `torch.manual_seed`.

    Raises:
        ValueError: no transform is found among the data set's attributes, nor those of the data sets that it wraps.
    """
    dataset = torch.utils.data.get_worker_info().dataset
    found = list(_transforms_of(dataset))
    if not found:
        raise ValueError(
            f"seed_worker found no albumentations transform among the attributes of {type(dataset).__name__}. Keep the "
            "Compose as one, or call its set_random_seed(torch.initial_seed() % 2**32) in a worker_init_fn of your own."
        )
    for transform in found:
        transform.set_random_seed(torch.initial_seed() % 2**32)


def _transforms_of(owner: torch.utils.data.Dataset) -> Iterator[BaseCompose | BasicTransform]:
    for attribute in vars(owner).values():
        short = isinstance(attribute, (list, tuple)) and len(attribute) <= 1000  # a list of samples holds no transform
        for value in attribute if short else [attribute]:
            if isinstance(value, (BaseCompose, BasicTransform)):
                yield value
            elif isinstance(value, torch.utils.data.Dataset):
                yield from _transforms_of(value)
