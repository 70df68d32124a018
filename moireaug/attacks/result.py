"""The result of an attack on a batch."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from moireaug.scene.mixed_shot import MixedShot
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
            f"{fooled} of the {right} right images fooled",
        ]
        if n:
            before, after = 100 * right / n, 100 * int(self.correct.sum()) / n
            parts.append(f"accuracy {before:.0f} to {after:.0f} % of {n}")
        if n and len(self.loss):
            steps = f"{len(self.loss)} step{'s' if len(self.loss) > 1 else ''}"
            parts.append(f"loss {self.loss[0]:.3g} to {self.loss[-1]:.3g} in {steps}")
        return f"Result({', '.join(parts)})"
