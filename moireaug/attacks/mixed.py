"""Attacks on a mixture of scenes: the images of each scene are attacked together, as a batch of
their own, and the results are joined."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from moireaug.attacks.checks import check_goals
from moireaug.attacks.result import Result, noise_tensor
from moireaug.image_checks import check_images
from moireaug.mixed_shot import MixedShot, in_order
from moireaug.scenes import Shot
from moireaug.shot_checks import check_batch


class SceneBatch(NamedTuple):
    """The b images of a batch that are photographed in one scene."""

    rows: Tensor  # (b,) indices in the batch
    shot: Shot
    images: Tensor
    labels: Tensor
    targets: Tensor | None


def split_by_scene(
    shot: MixedShot, images: Tensor, labels: Tensor, targets: Tensor | None
) -> list[SceneBatch]:
    """Return a batch for each scene of a shot.

    Raises:
        TypeError, ValueError: images that an attack does not take, or of another batch; labels or
            targets of the wrong type, shape or range.
    """
    check_batch(check_images(images), shot)
    labels, targets = check_goals(images, labels, targets)
    batches = []
    for scene_rows, scene_shot in shot.by_scene():
        rows = scene_rows.to(images.device)
        scene_targets = None if targets is None else targets[rows]
        batches.append(SceneBatch(rows, scene_shot, images[rows], labels[rows], scene_targets))
    return batches


def join(shot: MixedShot, rows: Sequence[Tensor], results: Sequence[Any], noise_at: str) -> Any:
    """Return the images, or the Results, of the scenes of a shot as those of the whole shot.

    Args:
        rows: (b,) indices in the batch of the images in each scene.
        results: (b, ...) tensor or Result of each scene.
        noise_at: as of `MoireAttack`.
    """
    if isinstance(results[0], Tensor):
        return in_order(rows, results)
    # the mixture, not the draw, says whether noise fits into one tensor
    noise: Tensor | list[Tensor]
    if noise_at == "photo" or len(shot.raw_shapes()) == 1:
        noise = in_order(rows, [noise_tensor(result) for result in results])
    else:
        by_scene = [image_noise for result in results for image_noise in result.noise]
        noise = [by_scene[place] for place in torch.cat(list(rows)).argsort().tolist()]
    shots = [result.shot for result in results]
    return Result(
        images=in_order(rows, [result.images for result in results]),
        success=in_order(rows, [result.success for result in results]),
        noise=noise,
        loss=_mean_curve([result.loss for result in results], [len(r) for r in rows]),
        eps=results[0].eps,
        shot=MixedShot.joined(shot.empty, shot.which, list(zip(rows, shots, strict=True))),
    )


def _mean_curve(curves: Sequence[Tensor], counts: Sequence[int]) -> Tensor:
    """Return the mean loss of each step, weighted by the images of each curve, over the curves that
    reach that step."""
    total = torch.zeros(max(map(len, curves)), dtype=torch.float32, device="cpu")
    weight = torch.zeros_like(total)
    for curve, count in zip(curves, counts, strict=True):
        total[: len(curve)] += count * curve
        weight[: len(curve)] += count
    return total / weight
