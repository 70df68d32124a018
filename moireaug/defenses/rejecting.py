"""A classifier that turns away what a detector flags."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor, nn

from moireaug.attacks.checks import check_is_tensor
from moireaug.common.argument_checks import check_callable, check_real


class Rejecting(nn.Module):
    """A model with a detector beside it: images whose score is above a threshold are rejected.

    Its logits have one more column than the model's, the last: the greatest of the model's logits
    plus the score's excess over the threshold, as in Carlini and Wagner's attack on detectors
    ("Adversarial examples are not easily detected", 2017, section 3). The attribute `rejects` tells
    attacks and evaluations what that column means: an attack succeeds where another class than the
    label wins and the image is let through; its loss goes through model and detector together.

    Args:
        model: [0, 1] images (B, 3, H, W) to logits (B, K); a module becomes a submodule.
        detector: [0, 1] images to scores (B,), greater for what is to be rejected; the same.
            Attacks need it differentiable.
        threshold: score above which an image is rejected, such as `scores.quantile(0.95)` of images
            that should pass.

    Raises:
        TypeError, ValueError: a part that is not callable, or a threshold that is no finite number;
            in a call, logits that are no tensor, or scores of another shape.
    """

    rejects = True
    buffers_follow_images = True
    threshold: Tensor

    def __init__(
        self,
        model: Callable[[Tensor], Tensor],
        detector: Callable[[Tensor], Tensor],
        threshold: float | Tensor,
    ) -> None:
        super().__init__()
        check_callable("model", model)
        check_callable("detector", detector, "scores (B,)")
        self.model, self.detector = model, detector
        value = threshold.item() if isinstance(threshold, Tensor) else threshold
        check_real("threshold", value, -math.inf)
        # in the state_dict, by which an evaluation tells models apart
        self.register_buffer("threshold", torch.tensor(float(value), device="cpu"))

    def forward(self, images: Tensor) -> Tensor:
        """Return the logits (B, K + 1) of images (B, 3, H, W) float in [0, 1]. Differentiable in
        images."""
        logits, scores = self.model(images.clone()), self.detector(images)  # may work in place
        check_is_tensor(logits)
        if not isinstance(scores, Tensor) or scores.shape != logits.shape[:1]:
            got = tuple(scores.shape) if isinstance(scores, Tensor) else type(scores).__name__
            raise ValueError(
                f"the detector must return scores ({len(logits)},), one per image; got {got}."
            )
        threshold, precision = self.threshold.to(scores.device), torch.finfo(logits.dtype)
        excess, top = (scores - threshold).to(logits), logits.amax(1)
        # an infinite score rejects too, whereas an infinite logit would be no answer
        rejection = top + excess.clamp(max=precision.max / 4)
        # and so does an excess that rounding loses; its gradient stays
        is_lost = (scores > threshold) & (rejection <= top)
        above = top + precision.eps * top.abs().clamp(min=1)
        rejection = rejection + torch.where(is_lost, above - rejection, 0).detach()
        return torch.cat([logits, rejection[:, None]], 1)
