"""The problem of a photographed screen: noise on the raw reading or on the photo, and the pose, the
ranges of some parts of a scene as numbers in [-1, 1]."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from moireaug.attacks.bounds import Bound
from moireaug.attacks.problem import Point, Problem
from moireaug.camera.pipeline import effects_by_name
from moireaug.capture import expose, photo_of_reading
from moireaug.common.argument_checks import one_of
from moireaug.common.numeric import clip, select_rows
from moireaug.scene.by_name import parts_with, values_of, with_values
from moireaug.scene.fields import bounds
from moireaug.scene.parts import PARTS
from moireaug.scene.plan import Plan
from moireaug.scene.shot import ShotRecord
from moireaug.scenes import Scene, Shot

ShotFunction = Callable[[Tensor, ShotRecord], Tensor]

# where noise is added: the stage before it, which checks the shot, and the stage after
NOISE_AT: dict[str, tuple[ShotFunction, ShotFunction]] = {
    "raw": (expose, photo_of_reading),
    "photo": (
        lambda images, shot: photo_of_reading(expose(images, shot), shot),
        lambda photo, shot: clip(photo),
    ),
}


@dataclass(eq=False)
class CameraProblem(Problem):
    """Noise on the readings or photos of a shot, at its own pose or at one that is searched.

    Args:
        images: (B, 3, H, W) images on the screen.
        shot: shot whose photos are judged.
        clean: (B, ...) readings or photos of `shot` without noise.
        bound: bound of the noise on `clean`.
        noise_at, optimise, eot: as of `attacks.MoireAttack`.
        generator: CPU generator of the draws of an expectation; None is torch's global one.
    """

    images: Tensor
    shot: Shot
    clean: Tensor
    bound: Bound
    noise_at: str
    optimise: tuple[str, ...]
    eot: int
    generator: torch.Generator | None

    def __post_init__(self) -> None:
        self.before_noise, self.after_noise = NOISE_AT[self.noise_at]
        self.fields = searched_fields(self.shot.scene, self.optimise)
        self.shape, self.views = tuple(self.clean.shape), self.eot
        if self.fields:
            self.pose = pose_of(self.shot, self.fields)
        elif self.eot == 1:
            self.base = self.clean
        self.noise_frozen = "noise" not in self.optimise
        self.effective_range = _effective_range(self.noise_at, self.shot.plan)
        self.unit, self.box = self.bound.unit, self.bound.box(self.clean)

    def render(self, point: Point) -> Tensor:
        if "pose" in point:
            return self._photos(self.images, self.shot_of(point), point["noise"])
        photos = self.after_noise(self.clean + self.box.noise(point["noise"]), self.shot)
        return photos.to(self.images.dtype)

    def forward_views(self, point: Point) -> Tensor:
        """Return the photos of the shot itself or, for an expectation, of `eot` fresh draws of its
        scene, each at the point's pose."""
        if self.eot == 1:
            return self.render(point)
        shots = self._fresh_shots(self.eot * len(self.images))
        if "pose" in point:
            shots = shot_at_pose(shots, self.fields, point["pose"].repeat(self.eot, 1))
        repeats = (self.eot, 1, 1, 1)
        return self._photos(self.images.repeat(repeats), shots, point["noise"].repeat(repeats))

    def _photos(self, images: Tensor, shot: Shot, noise: Tensor) -> Tensor:
        """Return the photos of images by a shot, with noise given by the variable of a search."""
        clean = self.before_noise(images, shot)
        reading = clean + self.bound.box(clean).noise(noise)
        return self.after_noise(reading, shot).to(images.dtype)

    def subset(self, rows: Tensor) -> CameraProblem:
        shot = self.shot[rows.to(self.shot.device)]
        return dataclasses.replace(
            self, images=self.images[rows], shot=shot, clean=self.clean[rows]
        )

    def drawn_again(self) -> CameraProblem:
        """Return the problem of a fresh draw of the scene."""
        shot = self._fresh_shots(len(self.images))
        clean = self.before_noise(self.images, shot)
        return dataclasses.replace(self, shot=shot, clean=clean)

    def where(self, chosen: Tensor, other: CameraProblem) -> CameraProblem:
        """Return the problem with the other's shot of the images of which `chosen` (B,) is true."""
        rows, own, others = chosen.to(self.shot.device), self.shot.numbers(), other.shot.numbers()
        numbers = {name: torch.where(rows, others[name], own[name]) for name in own}
        seed = torch.where(rows, other.shot.seed, self.shot.seed)
        shot = dataclasses.replace(self.shot, **parts_with(self.shot, numbers), seed=seed)
        clean = select_rows(chosen, other.clean, self.clean)
        return dataclasses.replace(self, shot=shot, clean=clean)

    def _fresh_shots(self, n: int) -> Shot:
        """Return n draws of the scene, of the same part of a larger image where the shot is one."""
        shots = self.shot.scene.sample(n, self.shot.whole_size, self.generator)
        if self.shot.part_of is not None:
            shots = shots.crop(*self.shot.corner, *self.shot.size)
        return shots.to(self.shot.device)

    def noise_of(self, point: Point) -> Tensor:
        box = self.box
        if "pose" in point:
            box = self.bound.box(self.before_noise(self.images, self.shot_of(point)))
        return box.noise(point["noise"])

    def shot_of(self, point: Point) -> Shot:
        return shot_at_pose(self.shot, self.fields, point["pose"]) if self.fields else self.shot


def _effective_range(noise_at: str, plan: Plan) -> tuple[float, float]:
    """Return the range of a reading or photo with noise, beyond which more noise changes nothing.

    A reading outside [0, 1] counts where an effect can bring it back before codes are clipped,
    unless the converter's bits or, above 1, the full well clip it first.
    """
    effects = effects_by_name()
    is_mixed = any(effects[name].mixes_readings for name in plan.developing)
    is_brought_back = is_mixed and "bits" not in plan
    if noise_at == "photo" or not is_brought_back:
        return 0.0, 1.0
    return -math.inf, 1.0 if "saturate" in plan else math.inf


# fields that nothing but a flicker reads
FLICKER_FIELDS = ("panel.pwm", "panel.duty", "panel.phase", "sensor.shutter", "sensor.readout")


def searched_fields(scene: Scene, optimise: tuple[str, ...]) -> list[str]:
    """Return the names, such as "view.yaw", of the ranged fields (low < high) of the parts that
    `optimise` names, in the order in which they are drawn, without those of a flicker that the
    scene's plan leaves out.

    Raises:
        ValueError: a part without a range, a pose that only takes whole degrees, or an exposure
            without a gradient.
    """
    fields: list[str] = []
    for part in optimise:
        if one_of("each of optimise", part, ("noise", *PARTS)) == "noise":
            continue
        unused = () if "flicker" in scene.plan() else FLICKER_FIELDS
        varied = []
        for name in values_of(scene):
            if name.startswith(f"{part}.") and scene.is_drawn(name) and name not in unused:
                varied.append(name)
        if not varied:
            raise ValueError(
                f"optimise names {part!r}, which has no range in this scene, or none that shows: "
                f"nothing can be moved. Give a field of {PARTS[part].__name__} a (low, high) pair."
            )
        if part == "view" and scene.view.pose == "released":
            raise ValueError(
                "optimise cannot turn View(pose='released'), which takes whole degrees and has no "
                "gradient; set pose='camera'."
            )
        fields += varied
    if fields and not scene.plan().method.differentiable_in_shot:
        raise ValueError(
            "optimise needs an exposure that is differentiable in the shot, 'spectral', 'box' or "
            f"'mean'; got {scene.plan().exposure!r} in the scene's plan. Set "
            "Sensor(exposure='spectral'), or 'box' for a lens that hardly blurs."
        )
    return fields


def _field_bounds(shot: Shot, fields: list[str]) -> tuple[Tensor, Tensor]:
    """Return the low and high ends of the fields' ranges, (F,) float64 each."""
    ranges = values_of(shot.scene)
    limits = [bounds(ranges[name]) for name in fields]
    low, high = torch.tensor(limits, dtype=torch.float64, device="cpu").to(shot.device).unbind(1)
    return low, high


def pose_of(shot: Shot, fields: list[str]) -> Tensor:
    """Return the pose of a shot, (B, F) float64: the place of each field in its range, from -1, the
    low end, to 1. A field outside of its range is taken at the nearest end."""
    low, high = _field_bounds(shot, fields)
    drawn = values_of(shot)
    values = torch.stack([drawn[name].detach() for name in fields], 1)
    return ((values - low) / (high - low) * 2 - 1).clamp(-1, 1)


def shot_at_pose(shot: Shot, fields: list[str], pose: Tensor) -> Shot:
    """Return the shot with its fields at `pose` (B, F); the inverse of `pose_of`, differentiable in
    the pose."""
    low, high = _field_bounds(shot, fields)
    values = low + (high - low) * (pose + 1) / 2
    # rounding must not leave the range; torch.clamp would stop the gradient at its ends
    values = values + (torch.minimum(torch.maximum(values.detach(), low), high) - values.detach())
    return with_values(shot, dict(zip(fields, values.unbind(1), strict=True)))
