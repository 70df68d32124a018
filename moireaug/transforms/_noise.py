"""An attacker's noise for the numpy images of a call, as one of its parameters: nested lists by
target."""

from __future__ import annotations

import itertools
import operator
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from moireaug.attacks import MoireAttack
from moireaug.attacks.search import Search
from moireaug.common.networks import device_of
from moireaug.scenes import Shot
from moireaug.transforms._arrays import check_same, planes
from moireaug.transforms._convert import (
    as_float_rgb,
    as_model_takes,
    model_of_photos,
    shot_of_frames,
)


def attack_pictures(
    attack: MoireAttack,
    pictures: dict[str, list[np.ndarray]],
    shot: Shot,
    label: int,
    generator: torch.Generator,
) -> dict[str, list]:
    """Return the noise after the attack's last step, as `Attack.last` shows it, for each picture of
    each target: one or more pictures of one height and width and of one class `label`, which share
    a shot of one draw but for sensor noise."""
    counts = [len(of_target) for of_target in pictures.values()]
    images = [planes(picture) for picture in itertools.chain(*pictures.values())]
    check_same("height and width", (tuple(image.shape[-2:]) for image in images))
    model = attack.model
    rgb = torch.cat([as_float_rgb(image) for image in images]).to(device_of(model))
    example = max(images, key=lambda image: image.shape[1])  # a colour picture, if there is one
    attack = replace(attack, model=model_of_photos(model, example.to(rgb.device)))

    taken, labels = as_model_takes(rgb, model), torch.full((len(rgb),), label, device="cpu")
    shots = shot_of_frames(shot.repeat(len(counts)), counts)

    def last_noise(search: Search) -> torch.Tensor:
        return search.problem.noise_of(attack.last_point(search))

    noise = attack.in_scenes(last_noise, taken, labels, None, shots, generator)
    rows = iter(noise.tolist())
    return {target: list(itertools.islice(rows, len(pictures[target]))) for target in pictures}


def noise_of(
    target: str, n: int, noise: dict[str, list] | None = None, **params: Any
) -> torch.Tensor | None:
    """Return an attacker's noise for the n pictures of a target, (n, *Shot.raw_shape()[1:]), from
    nested lists by target, or None where no attacker is at work; ValueError if there are fewer."""
    if noise is None:
        return None
    if len(noise.get(target, [])) < n:
        counts = ", ".join(f"{len(rows)} as {name}" for name, rows in noise.items()) or "none"
        raise ValueError(
            f"AdversarialMoire has noise for the pictures that it attacked: {counts}; got {n} as "
            f"{target}. Pass them to a replay as they were recorded."
        )
    return torch.tensor(noise[target][:n], dtype=torch.float32, device="cpu")


def label_of(data: dict[str, Any], key: str) -> int:
    """Return the index of the image's class, which a call passes under a key; refuse none, or one
    that is no integer: ValueError, TypeError."""
    if key not in data:
        raise ValueError(
            "AdversarialMoire needs the image's class: call the Compose with "
            f"{key}=<int>, or name another key by label_key; got the keys "
            f"{', '.join(sorted(data))}."
        )
    try:
        return operator.index(data[key])
    except TypeError:
        raise TypeError(
            f"{key} must be the index of the image's class, an integer; got {data[key]!r}."
        ) from None
