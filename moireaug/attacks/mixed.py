"""Attacks on a mixture of scenes: the images of each scene attacked together, the results as
one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import torch
from torch import Tensor

from moireaug.attacks.problem import Result, noise_tensor
from moireaug.checks import check_batch, check_images
from moireaug.mixed_shot import MixedShot, in_order
from moireaug.mixtures import Mixture
from moireaug.scenes import Scene, Shot

Found = TypeVar("Found")


def drawn_shot(
    scene: Scene | Mixture | None,
    images: Tensor,
    shot: Shot | MixedShot | None,
    generator: torch.Generator | None,
) -> Shot | MixedShot | None:
    """Return the shot that images are attacked in: the one given, or, in a mixture, one drawn; None
    where one scene is left to be drawn from, or there is none.

    Raises:
        TypeError, ValueError: images that an attack does not take, or of another batch.
    """
    if shot is None and isinstance(scene, Mixture):
        check_images(images)
        shot = scene.sample(len(images), (images.shape[-2], images.shape[-1]), generator)
    if isinstance(shot, MixedShot):
        check_batch(check_images(images), shot)
    return shot


def by_scene(
    shot: MixedShot,
    images: Tensor,
    goals: Sequence[Tensor | None],
    attack: Callable[..., Found],
) -> list[tuple[Tensor, Found]]:
    """Return what an attack finds in each scene, with the rows (b,) of its images.

    Args:
        goals: labels and targets, (B,) each, checked. attack: called with a scene's images, each of
            their goals, and `shot=`.
    """
    found = []
    for at, part in shot.by_scene():
        rows = at.to(images.device)
        own = [None if goal is None else goal[rows] for goal in goals]
        found.append((rows, attack(images[rows], *own, shot=part)))
    return found


def as_one(
    shot: MixedShot, found: Sequence[tuple[Tensor, Result | list[Result]]], noise_at: str
) -> Result | list[Result]:
    """Return the results of several scenes as that of the batch, or, of an attack at several
    bounds, those of the batch; see `Result`.

    Args:
        shot: that was attacked. noise_at: as of `MoireAttack`.
    """
    rows = [at for at, _ in found]
    lists = [result if isinstance(result, list) else [result] for _, result in found]
    results = [_as_one(shot, rows, of_bound, noise_at) for of_bound in zip(*lists, strict=True)]
    return results if isinstance(found[0][1], list) else results[0]


def _as_one(
    shot: MixedShot, rows: Sequence[Tensor], results: Sequence[Result], noise_at: str
) -> Result:
    shots = [result.shot for result in results if isinstance(result.shot, Shot)]  # all have one
    noise: Tensor | list[Tensor]
    # not by the shapes found: whether it is a tensor must not depend on the draw
    if noise_at == "photo" or len(shot.raw_shapes()) == 1:
        noise = in_order(rows, [noise_tensor(result) for result in results])
    else:
        each = [row for result in results for row in result.noise]
        noise = [each[place] for place in torch.cat(list(rows)).argsort().tolist()]
    return Result(
        in_order(rows, [result.images for result in results]),
        in_order(rows, [result.success for result in results]),
        noise,
        _mean_curve([result.loss for result in results], [len(at) for at in rows]),
        results[0].eps,
        MixedShot.joined(shot.empty, shot.which, list(zip(rows, shots, strict=True))),
    )


def _mean_curve(curves: Sequence[Tensor], counts: Sequence[int]) -> Tensor:
    """Return the mean of loss curves, weighted by the images of each, over those that are as
    long."""
    steps = max(map(len, curves))
    total, weight = torch.zeros(2, steps, dtype=torch.float32, device="cpu")
    for curve, count in zip(curves, counts, strict=True):
        total[: len(curve)] += count * curve
        weight[: len(curve)] += count
    return total / weight
