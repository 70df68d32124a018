"""Conditions: the images that a model is shown, from the clean ones to the last control. Attackers
are in `attackers.py`.

A condition is a record of settings with one method, `show`. Its settings say all that it depends on
besides the batch: two conditions with the same settings show the same images, whichever suite asks
for them.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from moireaug.attacks.bounds import bound_on_reading
from moireaug.attacks.checks import check_eps
from moireaug.capture import capture, develop, expose
from moireaug.common.numeric import clip
from moireaug.evaluation.identity import plain_or_identity
from moireaug.mixtures import Mixture
from moireaug.scene.mixed_shot import per_scene
from moireaug.scenes import Scene, Shot
from moireaug.synthesis.twins import moire_codes, without_moire

Model = nn.Module | Callable[[Tensor], Tensor]
ImageTransform = Callable[[Tensor], Tensor]
# columns of an evaluation's frame, see `frame.images_frame`, but for measures
CELL_COLUMNS = ["table", "row", "column"]
CONDITION_COLUMNS = ("condition", "control", "eps", "bound", "steps", "targeted", "judge")
ANSWER_COLUMNS = ("label", "target", "predicted", "correct", "fooled", "rejected", "undecided")
FRAME_COLUMNS = (*CELL_COLUMNS, *CONDITION_COLUMNS, *ANSWER_COLUMNS, "image", "counted", "seconds")
# names of fields that were others when the first records were written
NAMES_IN_RECORDS = {"known_classifier": "known_judge"}


@dataclass(frozen=True)
class EvalBatch:
    """One batch of an evaluation: a condition is shown the images of each scene of a mixture alone,
    see `in_scenes`.

    Args:
        model: function of [0, 1] images that returns logits.
        images: (B, 3, H, W) images in [0, 1].
        labels: (B,) true classes.
        targets: (B,) other classes, for targeted attacks.
        shot: Shot, or of a mixture MixedShot: one draw of the condition's scene per image.
        generator: generator of the condition's own random numbers.
        lpips: `LPIPS` that measures the visibility of an attack, besides the other figures, or
            None, as of every `control`.
        bound: what the eps of noise on a reading counts, "codes" or "light".
        max_images: number of images that a model or defence takes at once; None takes the batch.
    """

    model: Model
    images: Tensor
    labels: Tensor
    targets: Tensor
    shot: Any
    generator: torch.Generator
    lpips: nn.Module | None = None
    bound: str = "codes"
    max_images: int | None = None

    def __getitem__(self, rows: slice | Tensor) -> EvalBatch:
        return dataclasses.replace(
            self,
            images=self.images[rows],
            labels=self.labels[rows],
            targets=self.targets[rows],
            shot=self.shot[rows],
        )

    def in_scenes(self, compute: Callable[..., Any], *shown: Tensor, join: Any = None) -> Any:
        """Return what `compute` makes of the images in each scene, a batch of its own, and of their
        rows of what they are shown as, (B, ...); in the order of this batch, as `per_scene`."""

        def compute_in_scene(
            shot: Shot, images: Tensor, labels: Tensor, targets: Tensor, *shown: Tensor
        ) -> Any:
            batch = dataclasses.replace(
                self, images=images, labels=labels, targets=targets, shot=shot
            )
            return compute(batch, *shown)

        own = self.images, self.labels, self.targets
        return per_scene(self.shot, compute_in_scene, *own, *shown, join=join)


@dataclass(frozen=True, kw_only=True)
class Condition(ABC):
    """A way to show images to a model.

    Args:
        eps: bound of the noise, in [0, 1] units; 0 is no noise, whatever `EvalBatch.bound` is.
        targeted: whether being fooled means predicting the target's class.
        scene: scene of the photos, or a mixture; None is the evaluation's scene. Shots of one scene
            are drawn alike, so that all conditions of a scene share theirs.
        scene_name: name of that scene, part of this condition's name.

    Raises:
        TypeError: a class with the `kind` of its base.
        ValueError: an eps out of range.
    """

    kind: ClassVar[str]  # stands for the class in records
    control: ClassVar[bool] = True  # no attacker

    eps: float = 0.0
    targeted: bool = False
    scene: Scene | Mixture | None = None
    scene_name: str = ""

    def __init_subclass__(cls, **settings: Any) -> None:
        super().__init_subclass__(**settings)
        for base in cls.__mro__[1:]:
            base_kind = vars(base).get("kind")
            if base_kind is not None and base_kind == cls.kind:
                raise TypeError(
                    f"{cls.__name__} needs a kind of its own, a text that no other condition has; "
                    f"got {cls.kind!r}, by which its records would be taken for those of "
                    f"{base.__name__}."
                )

    def __post_init__(self) -> None:
        check_eps(self.eps)

    @property
    def name(self) -> str:
        """The condition's name in records: unique within a suite."""
        return self.base_name + (f"@{self.scene_name}" if self.scene_name else "")

    @property
    def base_name(self) -> str:
        return self.kind

    @abstractmethod
    def show(self, batch: EvalBatch) -> Tensor:
        """Return the images that the model is shown, (B, 3, H, W) in [0, 1]."""

    def measure(self, batch: EvalBatch, images: Tensor) -> dict[str, list[float]]:
        """Return further figures to record, one value per image, by names that are none of
        `FRAME_COLUMNS`."""
        return {}

    def eps_unit(self, bound: str) -> str:
        """Return what this condition's eps counts in an evaluation of that bound: "codes", "light",
        or nothing, "", where there is no noise. Records of different units are kept apart."""
        return bound if self.eps else ""

    def settings(self) -> dict[str, Any]:
        """Return all settings of this condition but its scene, as plain values; of a classifier, a
        tensor, a network and the like, its identity."""
        settings: dict[str, Any] = {"kind": self.kind}
        for field in dataclasses.fields(self):
            if field.name != "scene":
                value = getattr(self, field.name)
                name = NAMES_IN_RECORDS.get(field.name, field.name)
                settings[name] = plain_or_identity(getattr(value, "identity", value))
        return settings

    def at(self, scene_name: str, scene: Scene | Mixture) -> Condition:
        """Return the same condition in another scene."""
        return dataclasses.replace(self, scene_name=scene_name, scene=scene)


class Clean(Condition):
    """The image itself."""

    kind = "clean"

    def show(self, batch: EvalBatch) -> Tensor:
        return batch.images


class Dimmed(Condition):
    """The image, as dark as its photo."""

    kind = "dimmed"

    def show(self, batch: EvalBatch) -> Tensor:
        mean = batch.images.mean((1, 2, 3), keepdim=True)
        photo_mean = capture(batch.images, batch.shot).mean((1, 2, 3), keepdim=True)
        # a black image stays, and none gets brighter
        ratio = torch.where(mean > 0, photo_mean / mean.clamp(min=1e-6), 1.0).clamp(max=1.0)
        return clip(batch.images * ratio)


class BrightPhotoWithoutMoire(Condition):
    """The photo without moiré, as bright as its image: a gain brings white back to white."""

    kind = "rotated"

    def show(self, batch: EvalBatch) -> Tensor:
        shot = without_moire(batch.shot)
        white = capture(torch.ones_like(batch.images), shot).amax((1, 2, 3), keepdim=True)
        return clip(capture(batch.images, shot) / white.clamp(min=1e-6))


class Photo(Condition):
    """The photo, with its natural moiré and no noise."""

    kind = "moire"

    def show(self, batch: EvalBatch) -> Tensor:
        return capture(batch.images, batch.shot)

    def measure(self, batch: EvalBatch, images: Tensor) -> dict[str, list[float]]:
        """Return `moire`: the photo minus its twin, in codes RMS."""
        twins = capture(batch.images, without_moire(batch.shot))
        return {"moire": moire_codes(images, twins).tolist()}


class PhotoWithoutMoire(Condition):
    """The same photo of a panel without subpixels."""

    kind = "no_moire"

    def show(self, batch: EvalBatch) -> Tensor:
        return capture(batch.images, without_moire(batch.shot))


@dataclass(frozen=True, kw_only=True)
class RandomNoise(Condition):
    """The photo with noise of random sign on its raw image, at the bound `eps`: each value at
    either end of its interval."""

    kind = "random"
    eps: float = dataclasses.field()  # or it would have the 0 of its base

    @property
    def base_name(self) -> str:
        return f"random_{in_255ths(self.eps)}"

    def show(self, batch: EvalBatch) -> Tensor:
        shape = batch.shot.raw_shape()
        bits = torch.randint(0, 2, shape, generator=batch.generator, device="cpu")
        signs = bits.to(batch.images) * 2 - 1
        reading = expose(batch.images, batch.shot)
        box = bound_on_reading(self.eps, batch.bound, batch.shot.scene).box(reading)
        noise = box.noise(self.eps * signs)
        return develop(reading + noise, batch.shot).to(batch.images.dtype)


def controls(eps: float) -> dict[str, Condition]:
    """Return the controls of every attack: the image, and its photo without and with random
    noise."""
    return {"clean": Clean(), "moire": Photo(), "random": RandomNoise(eps=eps)}


def in_255ths(eps: float) -> str:
    """Return an eps in units of 1/255, as used in names and titles."""
    return f"{eps * 255:g}"
