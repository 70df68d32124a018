"""The camera as an adversary's variable: the ranges of some parts of a scene as numbers in [-1,
1]."""

from __future__ import annotations

import torch
from torch import Tensor

from moireaug.common.argument_checks import one_of
from moireaug.scene.by_name import values_of, with_values
from moireaug.scene.fields import bounds
from moireaug.scene.parts import PARTS
from moireaug.scenes import Scene, Shot

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
