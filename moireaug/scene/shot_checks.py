"""Checks of shots, and of readings and noise that belong to one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from torch import Tensor

from moireaug.common.numeric import is_transformed
from moireaug.common.physics.lens import MIN_LENS_SLOPE
from moireaug.scene.by_name import limits, limits_by_name, values_of
from moireaug.scene.lens import least_lens_slope
from moireaug.scene.mixed_shot import MixedShot
from moireaug.scene.shot import ShotRecord, check_tensor


def check_batch(shape: Sequence[int], shot: ShotRecord | MixedShot) -> None:
    """Refuse a batch of the shape (B, 3, H, W) that a shot was not drawn for (ValueError), and
    anything but a shot (TypeError)."""
    if not isinstance(shot, MixedShot):
        check_is_shot(shot)
    n, (count, _, h, w) = len(shot), shape
    if n != count or shot.size != (h, w):
        raise ValueError(
            f"the shot was drawn for {n} images of {shot.size[0]} x {shot.size[1]}; got "
            f"{count} of {h} x {w}. Draw one with "
            "scene.sample(len(images), images.shape[-2:])."
        )


def check_is_shot(shot: object) -> None:
    """Refuse anything but a shot of one scene, with a TypeError."""
    if isinstance(shot, MixedShot):
        raise TypeError(
            "a shot must be of one scene here; got the draw of a mixture. Go through its scenes "
            "by shot.by_scene()."
        )
    if not isinstance(shot, ShotRecord):
        raise TypeError(
            f"a shot must be a Shot; got a {type(shot).__name__}. Draw one with "
            "scene.sample(len(images), images.shape[-2:])."
        )


def checked_numbers(shot: ShotRecord) -> np.ndarray | None:
    """Return `shot.host_numbers()`, or None where torch.compile or torch.func hides them; refuse a
    number that no scene may have with a ValueError: kernels would look up out of bounds."""
    if is_transformed():
        return None
    table = shot.host_numbers()
    low, high = limits(shot.scene)
    if not ((table >= low) & (table <= high)).all():  # nor does NaN lie between them
        _refuse_numbers(shot)
    k1, k2 = (table[list(shot.numbers()).index(name)] for name in ("lens.k1", "lens.k2"))
    if (abs(3 * k1) + abs(5 * k2) < 1 - MIN_LENS_SLOPE).all():
        return table  # no slope can be as small
    for a, b in zip(k1.tolist(), k2.tolist(), strict=True):
        if least_lens_slope(a, b) <= MIN_LENS_SLOPE:
            raise ValueError(
                f"shot.lens.k1 = {a:g} and k2 = {b:g} fold the photo onto itself before its "
                "corners. Bring them closer to 0."
            )
    return table


def _refuse_numbers(shot: ShotRecord) -> None:
    """Name the first field of which a number lies out of bounds."""
    numbers = shot.numbers()
    for name, (least, greatest) in limits_by_name(shot.scene).items():
        values = numbers[name]
        if not ((values >= least) & (values <= greatest)).all():
            raise ValueError(
                f"a shot's numbers must be finite, and shot.{name} lie in [{least:g}, "
                f"{greatest:g}]; got {values.tolist()}. Its scene states "
                f"{values_of(shot.scene)[name]!r}: draw from it, or change the scene."
            )


def check_rows_of_noise(noise: object, shot: MixedShot) -> None:
    """Refuse noise of a mixture that is no tensor, nor a list of one tensor for each image:
    TypeError, ValueError."""
    if isinstance(noise, Tensor):
        count = len(noise) if noise.ndim else 0
    elif isinstance(noise, (list, tuple)) and all(isinstance(row, Tensor) for row in noise):
        count = len(noise)
    else:
        raise TypeError(
            "noise of a mixture must be a torch.Tensor or a list of one for each image; got "
            f"{type(noise).__name__}."
        )
    if count != len(shot):
        raise ValueError(f"noise must be of the {len(shot)} images of the shot; got {count} rows.")
    if isinstance(noise, Tensor):
        return
    for rows, part in shot.by_scene():
        for row in rows.tolist():
            _check_noise_shape(f"noise[{row}]", noise[row], part.raw_shape()[1:])


def check_noise(noise: object, shot: ShotRecord) -> None:
    """Refuse noise that is no floating point tensor of the shape `shot.raw_shape()`, or not finite:
    TypeError, ValueError."""
    noise = check_tensor("noise", noise)
    if not noise.is_floating_point():
        raise TypeError(
            f"noise must be a floating point tensor, in raw units; got a tensor of {noise.dtype}."
        )
    _check_noise_shape("noise", noise, shot.raw_shape())
    # readings are float32, where a larger number would become infinite
    if not is_transformed() and not noise.float().isfinite().all():
        raise ValueError(
            "noise must be finite in float32; got NaN, infinity or more. Look for it in the "
            "attack's gradients."
        )


def _check_noise_shape(name: str, noise: Tensor, shape: tuple[int, ...]) -> None:
    """Refuse, with a ValueError, noise that has not the shape of a raw reading."""
    if noise.shape != shape:
        raise ValueError(
            f"{name} must have the raw reading's shape {tuple(shape)}, see Shot.raw_shape(); "
            f"got {tuple(noise.shape)}."
        )


def check_raw(raw: Tensor, shot: ShotRecord) -> None:
    """Refuse a raw reading that is not floating point, or not of the shape `shot.raw_shape()`, and
    anything but a shot: TypeError, ValueError."""
    check_is_shot(shot)
    if not isinstance(raw, Tensor) or not raw.is_floating_point():
        got = f"a tensor of {raw.dtype}" if isinstance(raw, Tensor) else f"a {type(raw).__name__}"
        raise TypeError(
            f"raw must be a floating point tensor; got {got}. expose(images, shot) returns one."
        )
    expected = shot.raw_shape()
    if tuple(raw.shape) != expected:
        raise ValueError(
            f"raw must have the shape {expected} of this shot's reading, see Shot.raw_shape(); got "
            f"{tuple(raw.shape)}. To develop some rows, index both: develop(raw[rows], shot[rows])."
        )
