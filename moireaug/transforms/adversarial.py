"""AdversarialMoire: a batch transform that photographs each image with an attack's noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import PIL.Image
import torch
from torch import Tensor, nn
from torch.utils._pytree import tree_flatten, tree_unflatten
from torchvision.transforms import v2
from torchvision.transforms.v2._utils import _parse_labels_getter
from torchvision.tv_tensors import Video

from moireaug.attacks import MoireAttack
from moireaug.attacks.checks import as_tensor, check_labels
from moireaug.common.argument_checks import check_probability
from moireaug.common.networks import rejects_of
from moireaug.mixtures import SceneLike
from moireaug.transforms._convert import as_float_rgb, as_input, as_model_takes, model_of_photos
from moireaug.transforms._leaves import ANNOTATION_TYPES, IMAGE_TYPES, wrap
from moireaug.transforms._scenes import describe, planned_scenes, warn_without_moire

NO_BATCH_MESSAGE = (
    "a sample must hold one batch of images, a tensor (B, C, H, W), beside its labels; got {}."
)


class AdversarialMoire(v2.Transform):
    """Photograph images on a screen with the noise of a Moiré Attack after its last step,
    `MoireAttack.last`. Used like `v2.MixUp`: on a batch, in the training step or in a `collate_fn`.

        adversarial = AdversarialMoire(model, scene="screen_photo", eps=4 / 255, steps=5)
        images, labels = adversarial(images, labels)
        loader = DataLoader(data, collate_fn=lambda batch: adversarial(*default_collate(batch)))

    Args:
        model: [0, 1] images to logits; its mode, buffers and gradients are kept. Not a submodule.
        scene: a Scene, a preset's name or a dict, or a list of these, as in RandomMoire; one shot
            is drawn per image.
        eps, bound, steps, step_size, loss, random_start: as in `attacks.MoireAttack`.
            `steps=1, random_start=2, step_size=1` is N-FGSM (de Jorge et al., 2022).
        labels_getter: as in `v2.MixUp`: "default" takes the second of several inputs or, in a dict,
            the entry named "labels" or one with "label" in its name; or a callable that takes the
            sample and returns its labels.
        p: probability that an image is photographed; the others are returned unchanged.
        shrink: as in RandomMoire: images are parts of larger photos.

    A sample is images and labels, or any nesting of dicts, tuples and lists that holds them;
    everything else in it passes through untouched. Images are one pure tensor or
    `tv_tensors.Image` (B, C, H, W), C = 3 or 1 (grey), uint8 or float in [0, 1]; type, dtype and
    memory layout are kept. Grey images are shown as grey RGB and returned as the photos' luma; a
    model that takes one channel is given the luma, too. Labels are (B,) class indices, as integers
    or whole floats, or (B, classes) weights, as of `v2.MixUp`, `v2.CutMix` and one-hot encodings,
    in tensors or NumPy arrays; the class of the greatest weight is then attacked. They are returned
    unchanged. The photos are not differentiable in the images. Call with `generator=` to draw from
    a CPU generator instead of torch's global one.

    Raises:
        TypeError, ValueError: a sample without one batch of images and its labels; masks, boxes or
            key points with a scene in the camera's frame, where they would have to move; others
            as in `attacks.MoireAttack`.
    """

    _transformed_types = IMAGE_TYPES

    def __init__(
        self,
        model: nn.Module | Callable[[Tensor], Tensor],
        scene: SceneLike = "screen_photo",
        *,
        eps: float = 4 / 255,
        steps: int = 5,
        step_size: float | None = None,
        loss: str = "ce",
        random_start: float = 1.0,
        bound: str = "codes",
        labels_getter: Callable[[Any], Tensor] | str = "default",
        p: float = 1.0,
        shrink: float | tuple[float, float] | None = None,
    ) -> None:
        super().__init__()
        self.scene = planned_scenes(scene, shrink)
        self.p = check_probability(p)
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
        self._labels_getter = _parse_labels_getter(labels_getter)
        self._uses_default_labels = labels_getter == "default"

    def forward(self, *inputs: Any, generator: torch.Generator | None = None) -> Any:
        if not inputs:
            raise ValueError(NO_BATCH_MESSAGE.format("nothing"))
        sample = inputs if len(inputs) > 1 else inputs[0]
        labels = self._labels_of(sample)
        leaves, spec = tree_flatten(sample)
        index = self._image_index(leaves, labels)
        leaves[index] = self._photograph(leaves[index], labels, generator)
        return tree_unflatten(leaves, spec)

    def _labels_of(self, sample: Any) -> Any:
        """Return a sample's labels; torchvision's default looks for tensors alone."""
        is_pair = isinstance(sample, (tuple, list)) and len(sample) > 1
        if self._uses_default_labels and is_pair and isinstance(sample[1], np.ndarray):
            return sample[1]
        return self._labels_getter(sample)

    def _image_index(self, leaves: list[Any], labels: Any) -> int:
        """Return the index of the leaf that is the batch of images."""
        if self.scene.moves and any(isinstance(leaf, ANNOTATION_TYPES) for leaf in leaves):
            raise ValueError(
                "masks, boxes and key points would not move with the images, because this scene's "
                "photo stays in the camera's frame (Develop(registered=False)). Set "
                "registered=True, or leave them out."
            )
        other_leaves = [None if x is labels else x for x in leaves]
        needs_transform = self._needs_transform_list(other_leaves)
        indices = [index for index, needed in enumerate(needs_transform) if needed]
        if len(indices) != 1:
            raise ValueError(NO_BATCH_MESSAGE.format(f"{len(indices)} batches"))
        images = leaves[indices[0]]
        if isinstance(images, (PIL.Image.Image, Video)) or images.ndim != 4:
            got = "a PIL image"
            if isinstance(images, Tensor):
                got = "a video" if isinstance(images, Video) else f"the shape {tuple(images.shape)}"
            raise ValueError(
                f"images must be one batch (B, C, H, W); got {got}. Use AdversarialMoire after "
                "batching, in the training step or a collate_fn."
            )
        return indices[0]

    def _photograph(self, images: Tensor, labels: Any, generator: torch.Generator | None) -> Tensor:
        classes = classes_of(labels, len(images)).to(images.device)
        plain = images.detach().as_subclass(Tensor)
        uniform = torch.rand(len(images), dtype=torch.float32, generator=generator, device="cpu")
        rows = (uniform < self.p).nonzero().flatten().to(images.device)
        if not len(rows):
            return images
        warn_without_moire(self.scene, (images.shape[-2], images.shape[-1]))
        chosen = plain[rows]
        rgb = as_model_takes(as_float_rgb(chosen), self.attack.model)
        model = model_of_photos(self.attack.model, chosen)
        if labels.ndim == 2:
            model = _with_classes(model, labels.shape[1])
        attack = replace(self.attack, model=model)
        photos = attack.last(rgb, classes[rows], generator=generator)
        return wrap(plain.clone().index_copy_(0, rows, as_input(photos, chosen)), images)

    def extra_repr(self) -> str:
        a = self.attack
        return (
            f"scene={describe(self.scene)}, eps={a.eps}, bound={a.bound!r}, "
            f"steps={a.steps}, step_size={a.step_size}, loss={a.loss!r}, "
            f"random_start={a.random_start}, p={self.p}"
        )


def _with_classes(model: Callable[[Tensor], Tensor], n: int) -> Callable[[Tensor], Tensor]:
    """Return the model, of which logits of another number of classes than n are refused:
    ValueError."""
    rejects = rejects_of(model)

    def answer(images: Tensor) -> Tensor:
        logits = model(images)
        if not isinstance(logits, Tensor) or logits.ndim != 2:
            return logits  # the attack refuses it
        classes = logits.shape[1] - rejects
        if classes != n:
            raise ValueError(
                f"mixed labels must have one weight for each class, (B, {classes}) for this model; "
                f"got (B, {n})."
            )
        return logits

    answer.rejects = rejects  # type: ignore[attr-defined]
    return answer


def classes_of(labels: Any, n: int) -> Tensor:
    """Return the classes (n,) int64 of n labels: indices, whole floats, or (n, classes) weights;
    others are refused: TypeError, ValueError."""
    if isinstance(labels, np.ndarray):
        labels = as_tensor(labels, "labels")
    if not isinstance(labels, Tensor):
        raise TypeError(
            f"labels must be a tensor, (B,) or (B, classes); got {type(labels).__name__}. Say "
            "where they are in the sample with labels_getter."
        )
    if labels.dtype in (torch.uint16, torch.uint32, torch.uint64):
        labels = labels.long()  # torch compares none of them
    if labels.ndim == 2:
        if labels.shape[1] == 1:
            raise ValueError(
                f"labels of the shape {tuple(labels.shape)} are neither indices (B,) nor weights "
                "(B, classes). If they are indices, pass labels.squeeze(1)."
            )
        if len(labels) != n or labels.shape[1] == 0 or not (labels >= 0).all():
            raise ValueError(
                f"mixed labels must be weights >= 0 of the shape ({n}, classes); got "
                f"{tuple(labels.shape)}, from {labels.min().item() if labels.numel() else 0:.4g}."
            )
        return labels.long().argmax(1) if labels.dtype == torch.bool else labels.argmax(1)
    if labels.is_floating_point() and not (labels == labels.round()).all():
        raise ValueError(
            "labels (B,) in floating point must be whole numbers, class indices; got fractions or "
            "NaN. Mixed labels have the shape (B, classes)."
        )
    return check_labels(labels.long() if labels.is_floating_point() else labels, n, "labels")
