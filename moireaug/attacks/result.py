"""The result of an attack: of a mixture, joined from the results of its scenes, each of which is
attacked as a batch of its own."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from moireaug.scene.mixed_shot import MixedShot, join_rows
from moireaug.scenes import Shot


@dataclass(frozen=True, eq=False)
class Result:
    """The result of an attack on a batch.

    Args:
        images: (B, 3, H, W) adversarial images in [0, 1], the best found per image.
        success: (B,) bool; True where the label is not predicted or, in a targeted attack, the
            target is. Logits that are NaN or infinite predict nothing.
        noise: noise of each image: of `Shot.raw_shape()` on a raw image, (B, 3, H, W) on a photo
            or on pixels. In a mixture of scenes whose raw shapes differ, a list of B tensors, one
            per image.
        loss: (steps,) mean cross-entropy to the label (targeted: to the target) before each step of
            the last restart; with `until_fooled`, over the images that took it, and shorter where
            none was left. In a mixture, the mean of the scenes' own, weighted by their images.
        eps: L-infinity bound of the noise. Two attacks exceed it: the rule "printed", see
            `rules.Printed`, and N-FGSM, a `random_start` above 1. For `CW`, which has no bound, the
            largest absolute noise.
        shot: the Shot of the photos, in a mixture a `MixedShot`; where a pose was searched, the
            shot at the best pose; None for pixel attacks. `capture(images, shot, noise)` takes all
            of these.
        clean_correct, correct: (B,) bool; whether the label is predicted without noise (with a
            camera: of the photo), and of `images`. A rejected image is neither right nor a success.
        bound: scale of eps, "codes" or "light", as of `MoireAttack`; the noise itself is in units
            of what it is added to.
    """

    images: Tensor
    success: Tensor
    noise: Tensor | list[Tensor]
    loss: Tensor
    eps: float
    shot: Shot | MixedShot | None
    clean_correct: Tensor
    correct: Tensor
    bound: str = "codes"

    def __repr__(self) -> str:
        """Return a summary in one line, without the tensors. An image that is wrong without noise
        is not counted as fooled."""
        n, right = len(self.success), int(self.clean_correct.sum())
        fooled = int((self.success & self.clean_correct).sum())
        parts = [
            f"eps {255 * self.eps:.3g}/255 in {self.bound}",
            f"fooled {fooled} of {right} right without noise",
        ]
        if n:
            before, after = 100 * right / n, 100 * int(self.correct.sum()) / n
            parts.append(f"accuracy {before:.0f} to {after:.0f} % of {n}")
        if n and len(self.loss):
            steps = f"{len(self.loss)} step{'s' if len(self.loss) > 1 else ''}"
            parts.append(f"loss {self.loss[0]:.3g} to {self.loss[-1]:.3g} in {steps}")
        return f"Result({', '.join(parts)})"


def join_results(
    shot: MixedShot, rows: Sequence[Tensor], results: Sequence[Result], noise_at: str
) -> Result:
    """Return the Results of the scenes of a shot, of the images `rows` (b,) each, as that of the
    whole shot; noise at `noise_at`, as of `MoireAttack`."""
    joined: dict[str, Any] = {"loss": _mean_loss(results)}
    for name in ("images", "success", "clean_correct", "correct"):
        joined[name] = join_rows(rows, [getattr(result, name) for result in results])
    noises: list[Any] = [result.noise for result in results]  # of one scene, so a tensor, each
    # the mixture, not the draw, says whether noise fits into one tensor
    if noise_at == "photo" or len(shot.raw_shapes()) == 1:
        joined["noise"] = join_rows(rows, noises)
    else:
        image_noises = [noise for scene_noises in noises for noise in scene_noises]
        joined["noise"] = [image_noises[i] for i in torch.cat(list(rows)).argsort().tolist()]
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
