"""Denoising of the developed photo, by name."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from moireaug.camera.effects.base import Effect, Verdict, called, left_out
from moireaug.camera.effects.codes import check_only_backward, from_codes, to_codes
from moireaug.common.extras import require
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord

WINDOW = 5  # pixels: larger than the 3 x 3 that demosaicing has already smoothed
# sum of the differences of R, G and B: 8 codes each, above sensor noise and below most edges
SIGMA_COLOUR = 0.1
SIGMA_SPACE = 1.5  # pixels: the window's corners still have a weight of a sixth


class Denoise(Effect):
    """A denoiser on the codes of every sensor pixel."""

    name = "denoise"
    needs_every_pixel = True

    def verdict(self, scene: SceneRecord) -> Verdict:
        if scene.develop.denoise is None:
            return left_out("not asked for")
        return called(f"{scene.develop.denoise}, on every sensor pixel")

    def __call__(self, photo: Tensor, shot: ShotRecord) -> Tensor:
        name = shot.scene.develop.denoise
        return photo if name is None else DENOISERS[name](photo)


def nlm(photo: Tensor) -> Tensor:
    """Denoise with OpenCV's non-local means for colour images at its defaults, as the paper does
    (section 3, step 6).

    `cv2.fastNlMeansDenoisingColored` with strength 3 of 255, patches of 7 and a search window of 21
    pixels, on the photo's 8-bit codes. It mirrors the border, so any size works. Its 8-bit Lab
    changes even a flat colour by up to 4 codes.

    Args:
        photo: (B, 3, H, W) floating point in [0, 1], sRGB codes. Not modified.

    Returns:
        (B, 3, H, W), whole codes / 255, of the photo's dtype. The gradient passes straight
        through, by backward alone: neither by `torch.func.grad` nor forward.

    Raises:
        NotImplementedError: a forward derivative is asked for.
        ValueError: a photo that holds NaN.
        ModuleNotFoundError: OpenCV is not installed.
    """
    check_only_backward(photo, "the denoiser 'nlm'")
    return _nlm(photo)


def bilateral(photo: Tensor) -> Tensor:
    """Denoise with a bilateral filter: average each pixel with similar pixels around it; the edge
    pixels are repeated past the border.

    Takes and returns (B, 3, H, W) float32 or float64 in [0, 1]. Differentiable.
    """
    # on first use: importing kornia takes as long as all of this package
    from kornia.filters import bilateral_blur

    sigma = (SIGMA_SPACE, SIGMA_SPACE)
    # reflect, kornia's default, fails on images of 2 pixels or less
    return bilateral_blur(photo, WINDOW, SIGMA_COLOUR, sigma, border_type="replicate")


DENOISERS: dict[str, Callable[[Tensor], Tensor]] = {"nlm": nlm, "bilateral": bilateral}


# a custom operator, since torch.compile cannot trace it
@torch.library.custom_op("moireaug::nlm", mutates_args=())
def _nlm(photo: Tensor) -> Tensor:
    require("opencv", "the denoiser 'nlm'")
    import cv2

    def denoised(codes):
        bgr = cv2.fastNlMeansDenoisingColored(cv2.cvtColor(codes, cv2.COLOR_RGB2BGR))
        return cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)

    return from_codes(map(denoised, to_codes(photo)), photo)


@_nlm.register_fake
def _(photo: Tensor) -> Tensor:
    return photo.new_empty(photo.shape)


_nlm.register_autograd(lambda ctx, gradient: gradient)
