"""JPEG compression: the photo encoded and decoded again."""

from __future__ import annotations

import io

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from moireaug.camera.effects.base import Effect, Verdict, called, format_range, left_out
from moireaug.camera.effects.codes import check_only_backward, from_codes, to_codes
from moireaug.scene.fields import bounds
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord

# Kornia's rounding has no slope where a coefficient is a whole multiple of its step, as all are in
# flat black or white: an attack that starts without noise would be stuck there. This share of the
# gradient passes straight through.
STRAIGHT_THROUGH_SHARE = 0.02


class Jpeg(Effect):
    """Saves the photo as JPEG and reads it back."""

    name = "jpeg"

    def verdict(self, scene: SceneRecord) -> Verdict:
        quality = scene.develop.jpeg
        if bounds(quality)[1] == 0:
            return left_out("no quality given")
        return called(f"quality {format_range(quality)}")

    def __call__(self, photo: Tensor, shot: ShotRecord) -> Tensor:
        return jpeg(photo, shot.develop.jpeg)


def jpeg(photo: Tensor, quality: Tensor) -> Tensor:
    """Encode each photo with libjpeg and decode it again.

    The forward pass is the codec itself, as PIL runs it (4:2:0), on the photo's 8-bit codes. The
    backward pass is the gradient of kornia's differentiable JPEG (Shin and Song 2017; Reich et al.
    2024), computed only then, plus `STRAIGHT_THROUGH_SHARE` times the incoming gradient.

    Args:
        photo: (B, 3, H, W) float32 or float64 in [0, 1], sRGB codes. Not modified.
        quality: (B,), rounded to whole numbers and clamped to 1..100.

    Returns:
        (B, 3, H, W), whole codes / 255, of the photo's dtype. Differentiable in photo, by backward
        alone: neither by `torch.func.grad` nor forward; not in quality.

    Raises:
        NotImplementedError: a forward derivative is asked for.
        ValueError: NaN in photo or quality, or not one quality per photo.
    """
    check_only_backward(photo, "JPEG")
    return _jpeg(photo, quality.detach().round().clamp(1, 100))


# a custom operator, since torch.compile cannot trace it
@torch.library.custom_op("moireaug::jpeg", mutates_args=())
def _jpeg(photo: Tensor, quality: Tensor) -> Tensor:
    pairs = zip(to_codes(photo), quality.tolist(), strict=True)
    return from_codes((_recode(codes, int(q)) for codes, q in pairs), photo)


def _recode(codes: np.ndarray, quality: int) -> np.ndarray:
    # torchvision.io has the same codec, but deprecates it
    file = io.BytesIO()
    Image.fromarray(codes).save(file, "JPEG", quality=quality)
    return np.array(Image.open(file))


@_jpeg.register_fake
def _(photo: Tensor, quality: Tensor) -> Tensor:
    return photo.new_empty(photo.shape)


def _keep(ctx, inputs, output):
    ctx.save_for_backward(*inputs)


def _backward(ctx, gradient):
    photo, quality = ctx.saved_tensors
    if not photo.numel():  # kornia refuses an empty batch
        return gradient, None
    # on first use, as in `denoise.bilateral`
    from kornia.enhance import jpeg_codec_differentiable

    create_graph = torch.is_grad_enabled()  # the gradient itself is to be differentiated
    # autocast may be on where backward is called
    with torch.enable_grad(), torch.autocast(photo.device.type, enabled=False):
        photo = photo if create_graph else photo.detach().requires_grad_()
        out = jpeg_codec_differentiable(photo, quality)
        (back,) = torch.autograd.grad(out, photo, gradient, create_graph=create_graph)
    return back + STRAIGHT_THROUGH_SHARE * gradient, None


_jpeg.register_autograd(_backward, setup_context=_keep)
