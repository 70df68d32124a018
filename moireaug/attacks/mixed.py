"""Results of an attack on a mixture of scenes: the images of each scene are attacked as a batch of
their own, and their results joined."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from moireaug.attacks.result import Result, noise_tensor
from moireaug.mixed_shot import MixedShot, in_order


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
