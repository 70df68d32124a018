"""Results of an attack on a mixture of scenes: the images of each scene are attacked as a batch of
their own, and their results joined."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from moireaug.attacks.result import Result
from moireaug.scene.mixed_shot import MixedShot, join_rows


def join_results(
    shot: MixedShot, rows: Sequence[Tensor], results: Sequence[Result], noise_at: str
) -> Result:
    """Return the Results of the scenes of a shot as that of the whole shot.

    Args:
        rows: (b,) indices in the batch of the images in each scene.
        results: Result of each scene.
        noise_at: as of `MoireAttack`.
    """
    noises: list[Any] = [result.noise for result in results]  # of one scene, so a tensor, each
    noise: Tensor | list[Tensor]
    # the mixture, not the draw, says whether noise fits into one tensor
    if noise_at == "photo" or len(shot.raw_shapes()) == 1:
        noise = join_rows(rows, noises)
    else:
        noise_by_row: dict[int, Tensor] = {}
        for scene_rows, scene_noise in zip(rows, noises, strict=True):
            noise_by_row |= dict(zip(scene_rows.tolist(), scene_noise, strict=True))
        noise = [noise_by_row[row] for row in sorted(noise_by_row)]
    scene_shots = [(at, result.shot) for at, result in zip(rows, results, strict=True)]
    return Result(
        images=join_rows(rows, [result.images for result in results]),
        success=join_rows(rows, [result.success for result in results]),
        noise=noise,
        loss=_mean_loss(results),
        eps=results[0].eps,
        clean_correct=join_rows(rows, [result.clean_correct for result in results]),
        correct=join_rows(rows, [result.correct for result in results]),
        bound=results[0].bound,
        shot=MixedShot.from_shots(shot.scenes, shot.scene_index, scene_shots),
    )


def _mean_loss(results: Sequence[Result]) -> Tensor:
    """Return the mean loss of each step, weighted by the images of each result, over the results
    that reach that step."""
    n_steps = max(len(result.loss) for result in results)
    total = torch.zeros(n_steps, dtype=torch.float32, device="cpu")
    weight = torch.zeros_like(total)
    for result in results:
        steps, n_images = len(result.loss), len(result.images)
        total[:steps] += n_images * result.loss
        weight[:steps] += n_images
    return total / weight
