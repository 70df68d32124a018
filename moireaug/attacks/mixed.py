"""Results of an attack on a mixture of scenes: the images of each scene are attacked as a batch of
their own, and their results joined."""

from __future__ import annotations

import dataclasses
import itertools
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
        image_noises = list(itertools.chain.from_iterable(noises))
        noise = [image_noises[place] for place in torch.cat(list(rows)).argsort().tolist()]
    shots = [(at, result.shot) for at, result in zip(rows, results, strict=True)]
    return dataclasses.replace(
        results[0],
        images=join_rows(rows, [result.images for result in results]),
        success=join_rows(rows, [result.success for result in results]),
        noise=noise,
        loss=_mean_loss(results),
        clean_correct=join_rows(rows, [result.clean_correct for result in results]),
        correct=join_rows(rows, [result.correct for result in results]),
        shot=MixedShot.from_shots(shot.scenes, shot.scene_index, shots),
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
