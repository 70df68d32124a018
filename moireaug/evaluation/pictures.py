"""Examples for a report: the same images clean, photographed and attacked, with what each model says of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from moireaug.attacks import MoireAttack, evaluating, predicted
from moireaug.capture import capture
from moireaug.evaluation.rungs import Model, unless_broken
from moireaug.evaluation.words import answer
from moireaug.numeric import clip
from moireaug.scene.scene import Scene

AMPLIFY = 4  # how much an attack's change of the photo is enlarged to be seen


def examples(
    models: Mapping[str, Model],
    images: Tensor,
    labels: Tensor,
    scene: Scene,
    eps: float,
    steps: int,
    classes: Mapping[int, str],
    seed: int = 0,
) -> list[dict[str, Any]]:
    """One dict an image: its `label`, and `cells` of `title`, `image` (H, W, 3) uint8 and `predictions`.

    Every model is shown the same photo, and attacked on its own; predictions are (model, class name, right or not).
    """
    generator = torch.Generator().manual_seed(seed)
    shot = scene.sample(len(images), tuple(images.shape[-2:]), generator)
    photo = capture(images, shot)
    columns = [("clean image", images, models), ("photographed", photo, models)]
    for name, model in models.items():
        attack = MoireAttack(model=model, scene=scene, eps=eps, steps=steps)
        attacked = unless_broken(
            lambda attack=attack: attack(images, labels, shot=shot, generator=generator).images, lambda: photo
        )
        columns.append((f"attack on {name}, {eps * 255:g}/255", attacked, {name: model}))
        columns.append((f"its change, × {AMPLIFY}", clip(0.5 + AMPLIFY * (attacked - photo)), {}))
    said = [{n: _predict(m, shown) for n, m in asked.items()} for _, shown, asked in columns]
    out = []
    for i, label in enumerate(labels.tolist()):
        cells = [
            {
                "title": title,
                "image": _pixels(shown[i]),
                "predictions": [(n, answer(k[i], classes), k[i] == label) for n, k in answers.items()],
            }
            for (title, shown, _), answers in zip(columns, said, strict=True)
        ]
        out.append({"label": classes.get(label, str(label)), "cells": cells})
    return out


def _predict(model: Model, images: Tensor) -> list[int]:
    with evaluating(model), torch.no_grad():
        return predicted(model(images)).tolist()


def _pixels(image: Tensor) -> np.ndarray:
    return (image.detach().float().cpu() * 255).round().to(torch.uint8).permute(1, 2, 0).numpy()
