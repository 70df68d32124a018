"""Attacks on a mixture of scenes: the images of each scene are attacked together, as a batch of
their own, and the results are joined."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from moireaug.attacks.problem import Result, noise_tensor
from moireaug.image_checks import check_images
from moireaug.mixed_shot import MixedShot, in_order
from moireaug.mixtures import Mixture
from moireaug.scenes import Scene, Shot
from moireaug.shot_checks import check_batch


class SceneBatch(NamedTuple):
    """The b images of a batch that are photographed in one scene."""

    rows: Tensor  # (b,) indices in the batch
    shot: Shot
    images: Tensor
    labels: Tensor
    targets: Tensor | None


def drawn_shot(
    scene: Scene | Mixture | None,
    images: Tensor,
    shot: Shot | MixedShot | None,
    generator: torch.Generator | None,
) -> Shot | MixedShot | None:
    """Return the given shot, or, for a mixture, a new draw; None where one scene is left to draw
    from, or there is no scene.

    Raises:
        TypeError, ValueError: images that an attack does not take, or of another batch.
    """
    if shot is None and isinstance(scene, Mixture):
        check_images(images)
        size = (images.shape[-2], images.shape[-1])
        shot = scene.sample(len(images), size, generator)
    if isinstance(shot, MixedShot):
        check_batch(check_images(images).shape, shot)
    return shot


def split_by_scene(
    shot: MixedShot, images: Tensor, labels: Tensor, targets: Tensor | None = None
) -> list[SceneBatch]:
    """Return a batch for each scene of a shot; labels and targets are checked."""
    batches = []
    for scene_rows, scene_shot in shot.by_scene():
        rows = scene_rows.to(images.device)
        scene_targets = None if targets is None else targets[rows]
        batches.append(SceneBatch(rows, scene_shot, images[rows], labels[rows], scene_targets))
    return batches


def join_results(
    shot: MixedShot,
    batches: Sequence[SceneBatch],
    results: Sequence[Result | list[Result]],
    noise_at: str,
) -> Result | list[Result]:
    """Return the results of the batches of a shot, each one Result or a list with one per bound, as
    those of the whole shot; see `Result`. `noise_at` is that of `MoireAttack`."""
    lists = [result if isinstance(result, list) else [result] for result in results]
    joined = [_join(shot, batches, of_bound, noise_at) for of_bound in zip(*lists, strict=True)]
    return joined if isinstance(results[0], list) else joined[0]


def _join(
    shot: MixedShot, batches: Sequence[SceneBatch], results: Sequence[Result], noise_at: str
) -> Result:
    rows = [batch.rows for batch in batches]
    shots = [result.shot for result in results if isinstance(result.shot, Shot)]  # all have one
    # the mixture, not the draw, says whether noise fits into one tensor
    one_shape = noise_at == "photo" or len(shot.raw_shapes()) == 1
    return Result(
        images=in_order(rows, [result.images for result in results]),
        success=in_order(rows, [result.success for result in results]),
        noise=_join_noise(rows, results, one_shape),
        loss=_mean_curve([result.loss for result in results], [len(r) for r in rows]),
        eps=results[0].eps,
        shot=MixedShot.joined(shot.empty, shot.which, list(zip(rows, shots, strict=True))),
    )


def _join_noise(
    rows: Sequence[Tensor], results: Sequence[Result], one_shape: bool
) -> Tensor | list[Tensor]:
    """Return the noise in the order of the batch, as one tensor or as one per image."""
    if one_shape:
        return in_order(rows, [noise_tensor(result) for result in results])
    noise = [image_noise for result in results for image_noise in result.noise]
    order = torch.cat(list(rows)).argsort().tolist()
    return [noise[place] for place in order]


def _mean_curve(curves: Sequence[Tensor], counts: Sequence[int]) -> Tensor:
    """Return the mean loss of each step, weighted by the images of each curve, over the curves that
    reach that step."""
    steps = max(map(len, curves))
    total = torch.zeros(steps, dtype=torch.float32, device="cpu")
    weight = torch.zeros_like(total)
    for curve, count in zip(curves, counts, strict=True):
        total[: len(curve)] += count * curve
        weight[: len(curve)] += count
    return total / weight
