"""The entry points of the GPU's kernels, and the batches that they are compiled for."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from moireaug import Lens, Panel, Scene, Sensor, View
from moireaug.engine.development_records import Development
from moireaug.engine.exposure_records import Beats, Exposure
from moireaug.engine.shot_development import lower_development
from moireaug.engine.shot_exposure import lower_exposure

DEFAULT = "screen_photo"


class Case(NamedTuple):
    """A batch of a scene: what entry points take. Only the shapes of its tensors matter.

    Args:
        loop_lengths: of a kernel's loops, by its name, in the order in which they begin.
    """

    name: str
    images: Tensor
    raw: Tensor
    photo: Tensor
    exposure: Exposure
    beats: Beats | None
    development: Development
    loop_lengths: dict[str, tuple[int, ...]]


class Entry(NamedTuple):
    """A function that launches kernels, and whether it takes a case."""

    call: Callable[[Case], Any]
    takes: Callable[[Case], bool] = lambda case: True


def develop(case: Case) -> Tensor:
    from moireaug.engine.gpu.develop import develop

    return develop(case.raw, case.development)


def develop_back(case: Case) -> Tensor:
    from moireaug.engine.gpu.develop_back import develop_back

    return develop_back(case.raw, case.photo, case.development)


ENTRIES = {
    "develop": Entry(develop),
    "develop, backward": Entry(develop_back),
}


def cases(batch: int, side: int) -> list[Case]:
    """Return the default scene, whose readings are binned, and one of full readings: of a Bayer
    sensor, from the side, through a lens."""
    default = Scene.preset(DEFAULT)
    full = dataclasses.replace(
        default,
        panel=Panel(scale=3.0, lit=0.7),
        view=View(yaw=(-20.0, 20.0)),
        lens=Lens(blur=0.5, k1=(-0.05, 0.05)),
        sensor=Sensor(scale=2.0, reading="full", crosstalk=(0.1, 0.25), gain=2.0),
        develop=dataclasses.replace(default.develop, chroma_blur=1.5, sharpen_radius=1.0),
    )
    return [_case(name, scene, batch, side) for name, scene in ((DEFAULT, default), ("full", full))]


def _case(name: str, scene: Scene, batch: int, side: int) -> Case:
    shot = scene.sample(batch, (side, side), torch.Generator().manual_seed(0))
    images = torch.zeros(batch, 3, side, side)
    development = lower_development(shot)
    return Case(
        name,
        images,
        torch.zeros(shot.raw_shape()),
        torch.zeros_like(images),
        *lower_exposure(shot, decoded=False),
        development,
        loop_lengths(development),
    )


def loop_lengths(development: Development) -> dict[str, tuple[int, ...]]:
    """Return `Case.loop_lengths`. Loops of length 1 are not compiled."""
    codes, detail = development.codes, development.detail
    blur = max(detail.chroma_size, detail.sharp_size)
    taps = [axis.taps.shape[1] for axis in (detail.rows, detail.cols, codes.rows, codes.cols)]
    photo_pixels = [
        int((axis.last - axis.first).max()) + 1
        for axis in (detail.rows, detail.cols, codes.rows, codes.cols)
    ]
    lengths = {
        "develop_kernel": taps[2:],
        "blur_rows_kernel": [blur],
        "finish_kernel": [*taps[:2], blur],
        "finish_back_kernel": [blur, *photo_pixels[:2]],
        "filter_back_kernel": [blur],
        "light_back_kernel": photo_pixels[2:],
    }
    long = {name: tuple(n for n in some if n > 1) for name, some in lengths.items()}
    return long | {"demosaic_back_kernel": (4, 1, 1)}  # planes; folds, which few tiles have
