"""A batch by its scenes: the images of each are attacked as a batch of their own, and their results
joined."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from moireaug.attacks.result import Result
from moireaug.scene.mixed_shot import MixedShot, join_rows
from moireaug.scenes import Shot


class Batch(NamedTuple):
    """A batch to attack, as of a call of an `Attack`, with the shot of its photos: None without a
    camera."""

    images: Tensor
    labels: Tensor
    targets: Tensor | None
    shot: Any
    generator: torch.Generator | None

    def by_scene(self) -> list[Batch]:
        """Return the images in each scene, a batch each."""
        if not isinstance(self.shot, MixedShot):
            return [self]
        parts = []
        for rows, shot in self.shot.by_scene():
            targets = None if self.targets is None else self.targets[rows]
            parts.append(Batch(self.images[rows], self.labels[rows], targets, shot, self.generator))
        return parts


def join_images(shot: Shot | MixedShot | None, parts: Sequence[Tensor]) -> Tensor:
    """Return the images of the scenes of a shot, (b, ...) each, in the order of the batch."""
    if not isinstance(shot, MixedShot):
        return parts[0]
    return join_rows([rows for rows, _ in shot.by_scene()], parts)


def join_results(shot: MixedShot, results: Sequence[Result], noise_at: str) -> Result:
    """Return the Results of the scenes of a shot as that of the whole shot; noise at `noise_at`, as
    of `MoireAttack`."""
    rows = [rows for rows, _ in shot.by_scene()]
    joined: dict[str, Any] = {"loss": _mean_loss(results)}
    for name in ("images", "success", "clean_correct", "correct"):
        joined[name] = join_rows(rows, [getattr(result, name) for result in results])
    noises: list[Any] = [result.noise for result in results]  # of one scene, so a tensor, each
    # the mixture, not the draw, says whether noise fits into one tensor
    if noise_at == "photo" or len(shot.raw_shapes()) == 1:
        joined["noise"] = join_rows(rows, noises)
    else:
        image_noises = [noise for scene_noises in noises for noise in scene_noises]
        joined["noise"] = [image_noises[i] for i in torch.cat(rows).argsort().tolist()]
    shots: list[Any] = [result.shot for result in results]
    joined["shot"] = MixedShot.from_shots(
        shot.scenes, shot.scene_index, list(zip(rows, shots, strict=True))
    )
    return dataclasses.replace(results[0], **joined)


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
