"""Checks of pictures: which are accepted.

A float image may lie a little outside [0, 1]: resizing overshoots at edges, noise is not always
clipped. Both leave the mean nearly unchanged; normalisation does not. So an image is accepted, and
clipped, if

- clipping changes its values by at most `MAX_CLIPPED_RMS`, root mean square, and
- the mean of each channel lies at most `MAX_MEAN_OUTSIDE` outside [0, 1],

and refused otherwise, image by image. The largest changes measured on photographs, and on random
black and white pixels: bicubic, 0.05 and 0.08; Lanczos, 0.04 and 0.145; Gaussian noise of standard
deviation 0.2, 0.14 and 0.16. Photographs normalised by the statistics of ImageNet or CIFAR-10
change by 0.8 (median), and 996 of 1000 are refused; of those scaled to [-1, 1], 94 of 100, and the
others are bright.
"""

from __future__ import annotations

from torch import Tensor

from moireaug.common.numeric import clip, is_transformed, widen_half

MAX_CLIPPED_RMS = 0.18
MAX_MEAN_OUTSIDE = 0.1
GREY_HINT = (
    " Show grey images as RGB, images.expand(-1, 3, -1, -1); give a model of one channel the "
    "luma of photos, lambda images: model(rgb_to_grayscale(images)), with "
    "torchvision.transforms.v2.functional.rgb_to_grayscale."
)


def check_images(image: Tensor) -> Tensor:
    """Return a float batch (B, 3, H, W) clipped to [0, 1], gradient as in `clip`; the same tensor
    if it already lies there. Others are refused: TypeError, ValueError."""
    check_shape(image)
    if not image.is_floating_point():
        raise TypeError(
            f"images must be floating point in [0, 1]; got {image.dtype}. Divide uint8 images by "
            "255, or use moireaug.transforms.RandomMoire, which takes them as they are."
        )
    if not is_transformed():
        if not image.numel():
            return image
        low, high = (v.item() for v in image.detach().aminmax())
        if low >= 0 and high <= 1:
            return image
        _check_pictures(image.detach())
    return clip(image)


def check_shape(image: Tensor) -> None:
    """Refuse what is not a batch (B, 3, H, W), of any dtype: TypeError, ValueError."""
    if not isinstance(image, Tensor):
        raise TypeError(
            f"images must be a torch.Tensor; got {type(image).__name__}. Use moireaug.transforms "
            "for PIL and numpy."
        )
    if image.ndim != 4 or image.shape[1] != 3 or 0 in image.shape[-2:]:
        grey_hint = GREY_HINT if image.ndim == 4 and image.shape[1] == 1 else ""
        raise ValueError(
            "images must have the shape (B, 3, H, W) with H, W >= 1; got "
            f"{tuple(image.shape)}.{grey_hint}{channels_last_hint(image)}"
        )


def channels_last_hint(image: Tensor) -> str:
    """Return how to put the channels first if they seem to be last, else an empty string."""
    orders = {3: "permute(2, 0, 1)", 4: "permute(0, 3, 1, 2)"}
    if image.shape[-1:] not in ((1,), (3,), (4,)) or image.ndim not in orders:
        return ""
    return f" Their channels seem to be last: put them first with {orders[image.ndim]}."


def _check_pictures(images: Tensor) -> None:
    """Refuse a batch with an image that cannot be a picture in [0, 1]."""
    images = widen_half(images)
    outside = images - images.clamp(0, 1)
    change = outside.square().mean((1, 2, 3)).sqrt()
    mean = images.mean((2, 3))
    far = (mean - mean.clamp(0, 1)).abs().amax(1)
    # False where there is NaN or infinity
    accepted = (change <= MAX_CLIPPED_RMS) & (far <= MAX_MEAN_OUTSIDE)
    if accepted.all():
        return
    first = int((~accepted).nonzero()[0])
    raise ValueError(
        f"images must be finite and lie in [0, 1]; got {_looks_like(images[first], first)}."
    )


def _looks_like(image: Tensor, row: int) -> str:
    """Say what a refused image looks like, and what to do."""
    if image.isnan().any():
        return f"NaN in image {row}. Check the code that made the images"
    if image.isinf().any():
        return f"infinity in image {row}. Check the code that made the images"
    low, high = (v.item() for v in image.aminmax())
    got = f"values from {low:.9g} to {high:.9g} in image {row}"
    if high > 3 and low > -high / 4:  # no usual normalisation reaches 3
        full = 255 if high < 400 else 65535
        return f"{got}, which look like 0 to {full}. Divide them by {full}"
    return (
        f"{got}, which look normalised, or noisier than a standard deviation of 0.2. Undo the "
        "normalisation first: put it into the model with attacks.Normalized"
    )
